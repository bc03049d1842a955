"""The GPU backend measured: beside gsplat, beside the paper's procedure, and against what the device can do at most.

python -m benchmarks.gpu --help
"""

import importlib.util
import sys
from pathlib import Path

_found = importlib.util.find_spec("scoup")
if _found is None or _found.origin is None:  # a checkout in which nothing is installed
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src"))
