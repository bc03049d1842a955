#!/bin/sh
# Measures everything that is known of a GPU, in eight minutes at most: tools/measure_gpu.sh FOLDER [options]
#
# Run it again with the same folder to go on where it stopped: rows that are there are kept. FOLDER/gpu.json is the
# record for docs/benchmarks, FOLDER/tests.txt what the tests of kernels say. Options go to `python -m benchmarks gpu`.
# Needs what docs/gpu.md lists.
set -u
folder=$1
shift
mkdir -p "$folder"
cd "$(dirname "$0")/.."
export PYTHONPATH="$PWD/src:$PWD${PYTHONPATH:+:$PYTHONPATH}"
left=360
state=1
for _ in 1 2 3 4 5 6 7 8; do # a kernel that breaks the device ends the process, not the rest
    began=$(date +%s)
    timeout "$left" python3 -m benchmarks gpu --rows "$folder/rows.json" --out "$folder/gpu.json" --overwrite "$@" && state=0 && break
    left=$((left - $(date +%s) + began))
    [ "$left" -gt 20 ] || break
done
OMP_NUM_THREADS=1 timeout 120 python3 -m pytest -q -n auto tests/raster/test_gpu.py tests/uplift/test_vote_gpu.py \
    tests/coding/test_gpu_coder.py >"$folder/tests.txt" 2>&1
exit $state
