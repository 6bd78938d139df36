#!/usr/bin/env bash
# Three trainings at once on one GPU with 16 cores, 390 s each after rooms and labels: gpu.sh SMALL_FRAMES OUTPUT [settings of all three]
# SMALL_FRAMES is from small_frames.py; where ELDENET_DATA is set, its data sets are used instead. A training that runs
# out of time goes on when this is started again.
# Does it run? ROOMS=64 SECONDS_EACH=60 bash experiments/indoor/gpu.sh small_frames.tar runs runtime.device=cpu trainer.cuda_graph=false
set -euo pipefail
cd "$(dirname "$0")/../.."
frames=$1 output=$2 rooms=${ROOMS:-24576} seconds=${SECONDS_EACH:-390}
shift 2
export ELDENET_DATA="${ELDENET_DATA:-$output/data}"
[ -d "$ELDENET_DATA" ] || python experiments/indoor/small_frames.py unpack "$frames" "$ELDENET_DATA"
mix=("data.sources.rooms.data.frames=$rooms" data.val.split=dev)   # the held-out frames stay at home
python - "${mix[@]}" <<'PREPARE'
import sys

from eldenet.compose import compose
from eldenet.evaluation.splits import chosen_protocol, open_split
from eldenet.train import TrainSettings

if __name__ == "__main__":
    data = compose(TrainSettings, ["+experiment=indoor_lite_gpu", *sys.argv[1:]]).data
    open_split(data, "train", protocol=chosen_protocol(data, None))   # renders the rooms, labels the photographs
PREPARE
train() { # name, settings
    local status=0
    timeout "$seconds" python -m eldenet.train "+experiment=$1" "output=$output/$1" ckpt_path=auto \
        runtime.workers=4 runtime.threads=1 "${@:2}" > "$output/$1.log" 2>&1 || status=$?
    tail -n 1 "$output/$1.log"
    [ "$status" = 124 ] || return "$status"   # 124: out of time
}
train rooms_lite_small_gpu "data.frames={train: $rooms, val: 64, test: 64}" "$@" &
train indoor_lite_small_gpu "${mix[@]}" "$@" &
train indoor_lite_gpu "${mix[@]}" "$@" &
failed=0
for job in $(jobs -p); do wait "$job" || failed=$?; done
exit "$failed"
