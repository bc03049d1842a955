#!/bin/bash
# Build a field with Slurm: an array of COUNT tasks makes the region sums, each of a part of the views, and a job behind
# the array builds the field from them.
#
#     bash examples/slurm.sh SCENE FIELD.scoup COUNT [OPTION OF SCOUP BUILD --SUMS ...]
#
# The scene and the folder of the field are on a file system that all nodes see, and `scoup` is on the PATH (activate
# its environment first: sbatch passes the variables on). After a failure, run the same line again: views that are done
# are not made again. LIMITS: other limits of the jobs, such as LIMITS="--partition=gpu --gpus=1".
set -euo pipefail

scene=$1 field=$2 count=${3:?pass SCENE FIELD.scoup COUNT}
limits=(--cpus-per-task=4 --mem=16G --time=02:00:00 ${LIMITS:-})
printf -v options '%q ' "${@:4}"
printf -v scene '%q' "$scene"
printf -v out '%q' "$field"

# Killed (137), as when memory runs out: again, three times at most. Signals to the job reach scoup, which cleans up.
parts=$(sbatch --parsable "${limits[@]}" --array="1-$count" --job-name=scoup-part --output='%x-%A-%a.log' --wrap "
export OMP_NUM_THREADS=\${SLURM_CPUS_PER_TASK:-1}
for attempt in 1 2 3; do
    srun scoup build $scene --keep-sums $out.sums --part \$SLURM_ARRAY_TASK_ID/$count && exit
    code=\$?
    [ \$code = 137 ] || exit \$code
done
exit \$code")
# If a task fails, the build is withdrawn. (On several clusters the id has a name, ";NAME".)
sbatch "${limits[@]}" --dependency="afterok:${parts%%;*}" --kill-on-invalid-dep=yes --job-name=scoup-build \
    --output='%x-%j.log' --wrap "exec scoup build $scene --sums $out.sums --out $out --overwrite $options"
