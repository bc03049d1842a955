"""The GPU backend: compared with the reference, and timed beside gsplat and the paper's procedure.

python -m benchmarks.gpu --help
"""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

_found = importlib.util.find_spec("scoup")
if _found is None or _found.origin is None:  # a checkout in which nothing is installed
    sys.path.insert(0, str(ROOT / "src"))
