#!/usr/bin/env bash
# Everything that a GPU speeds up, in slices of at most ten minutes each; a slice that fails or takes longer is reported,
# and the next one runs. Their output goes to FOLDER/SLICE.txt, numbers to FOLDER/SLICE.json, the tables to
# FOLDER/tables.md.
#
#   benchmarks/gpu.sh [FOLDER] [SLICE ...]              all slices: generate env data train_NAME of recipes/train
#   DEVICE=cpu TINY=1 benchmarks/gpu.sh /tmp/rehearsal  see that everything runs, where there is no GPU
set -uo pipefail
cd "$(dirname "$0")/.."
out=$(realpath -m "${1:-outputs/gpu}")
device=${DEVICE:-cuda} tiny=() few=() steps=500
export EPISODES=256 out
if [ -n "${TINY:-}" ]; then tiny=(--tiny) few=(--batch_size=2 --num_workers=0) steps=2 EPISODES=2; fi
chosen=("${@:2}")
mkdir -p "$out"
export MUJOCO_GL=${MUJOCO_GL:-egl}
[ "$device" = cuda ] || export CUDA_VISIBLE_DEVICES=

slice() { # NAME COMMAND ...
    local name=$1 begin=$SECONDS state=done
    shift
    [ ${#chosen[@]} = 0 ] || [[ " ${chosen[*]} " = *" $name "* ]] || return 0
    timeout 600 "$@" >"$out/$name.txt" 2>&1 || state="exit code $?"
    { echo "## $name: $state, $((SECONDS - begin)) s"; echo '```'; table "$name"; echo '```'; } | tee -a "$out/tables.md"
}

table() { # what a slice printed; of a training its last progress, of a failure its end
    grep -a -E 'step:|updt_s' "$out/$1.txt" | tail -1 | grep . || tail -15 "$out/$1.txt"
}

data() { # what recipes/train reads, as their headers generate it, but fewer episodes
    local line root recipe
    for recipe in recipes/train/*.yaml; do
        line=$(sed -n 's/^#   \(dynahoi generate .*\)/\1/p' "$recipe" | head -1)
        root=$(sed -n 's/.*--root \([^ ]*\).*/\1/p' <<<"$line")
        [ -e "$out/$root" ] && continue
        $(sed "s|--root [^ ]*|--root $out/$root|; s|--episodes [0-9]*|--episodes $EPISODES|" <<<"$line") || return
    done
}

: >"$out/tables.md"
slice generate python benchmarks/generate.py --device "$device" "${tiny[@]}" --json "$out/generate.json"
slice env python benchmarks/env.py --num-envs 64 --rounds 1 "${tiny[@]}" --json "$out/env.json"
export -f data
slice data bash -c data
for recipe in recipes/train/*.yaml; do
    name=$(basename "$recipe" .yaml)
    root=$(sed -n 's/^dataset:.*root: \([^,}]*\).*/\1/p' "$recipe")
    slice "train_$name" lerobot-train --config_path="$recipe" --policy.device="$device" --dataset.root="$out/$root" \
        --output_dir="$out/train/$name" --steps=$steps --log_freq=$((steps / 2)) --save_checkpoint=false "${few[@]}"
done
! grep -q ': exit code' "$out/tables.md"
