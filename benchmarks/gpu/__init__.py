"""The GPU backend measured: beside gsplat, beside the paper's procedure, and against what the device can do at most.

python -m benchmarks.gpu --help
"""
