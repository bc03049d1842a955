#!/bin/bash
# Build the field of a scene in COUNT shards, one array task a shard, and merge them when all of them are there.
#
#     bash examples/slurm/submit.sh SCENE FIELD.scoup COUNT [OPTION OF SCOUP BUILD --SHARD ...]
#
# The scene and the folder of the field are on a file system that all nodes see, and `scoup` is on the PATH (activate
# its environment first: sbatch hands the variables on). After a failure, run the same line again: shards that are there
# are passed over, and an interrupted one goes on where it stopped. Other limits of the jobs: SBATCH_PARTITION and the
# like, or the #SBATCH lines of shard.sbatch and merge.sbatch.
set -euo pipefail

field=${2:?give SCENE FIELD.scoup COUNT}
count=${3:?give SCENE FIELD.scoup COUNT}
here=$(dirname "$0")

shards=$(sbatch --parsable --array="1-$count" "$here/shard.sbatch" "$@")
# Should a task fail, the merge is withdrawn instead of waiting for ever. (On several clusters the id has a name, ";NAME".)
sbatch --dependency="afterok:${shards%%;*}" --kill-on-invalid-dep=yes "$here/merge.sbatch" "$field" "$count"
