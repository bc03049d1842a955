"""Measuring: the stages of the method on a random scene of any size, interleaved medians, one table and JSON.

``scoup bench`` and the scripts of ``benchmarks/`` are made of these.
"""

from scoup.bench.environment import describe_environment as describe_environment
from scoup.bench.measure import DeviceClock as DeviceClock
from scoup.bench.measure import Slope as Slope
from scoup.bench.measure import StageClock as StageClock
from scoup.bench.measure import Stopwatch as Stopwatch
from scoup.bench.measure import Task as Task
from scoup.bench.measure import Timing as Timing
from scoup.bench.measure import Watch as Watch
from scoup.bench.measure import fit_slope as fit_slope
from scoup.bench.measure import time_tasks as time_tasks
from scoup.bench.measure import torch_threads as torch_threads
from scoup.bench.report import Row as Row
from scoup.bench.report import comparison as comparison
from scoup.bench.report import markdown as markdown
from scoup.bench.report import stage_table as stage_table
from scoup.bench.report import write_json as write_json
from scoup.bench.stages import STAGES as STAGES
from scoup.bench.stages import Workload as Workload
from scoup.bench.stages import make_workload as make_workload
from scoup.bench.stages import random_workload as random_workload
from scoup.bench.stages import stage_runs as stage_runs
from scoup.bench.stages import time_stages as time_stages
from scoup.bench.stages import usable_backends as usable_backends
from scoup.synthetic.random_scene import random_scene_cameras as random_scene_cameras
from scoup.synthetic.random_scene import random_scene_gaussians as random_scene_gaussians
from scoup.synthetic.random_scene import random_scene_regions as random_scene_regions
