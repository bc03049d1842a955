"""Measuring: the stages of the method on a random scene of any size, interleaved medians, tables and JSON.

The studies of ``benchmarks/`` are made of these.
"""

from scoup_lab.bench.environment import describe_environment as describe_environment
from scoup_lab.bench.measure import StageClock as StageClock
from scoup_lab.bench.measure import Stopwatch as Stopwatch
from scoup_lab.bench.measure import Task as Task
from scoup_lab.bench.measure import time_tasks as time_tasks
from scoup_lab.bench.measure import torch_threads as torch_threads
from scoup_lab.bench.report import markdown as markdown
from scoup_lab.bench.report import write_json as write_json
from scoup_lab.bench.stages import STAGES as STAGES
from scoup_lab.bench.stages import Workload as Workload
from scoup_lab.bench.stages import random_workload as random_workload
from scoup_lab.bench.stages import stage_runs as stage_runs
from scoup_lab.bench.stages import usable_backends as usable_backends
from scoup_lab.synthetic.random_scene import random_scene_cameras as random_scene_cameras
from scoup_lab.synthetic.random_scene import random_scene_gaussians as random_scene_gaussians
from scoup_lab.synthetic.random_scene import random_scene_regions as random_scene_regions
