#!/usr/bin/env bash
# Benches pretrained where they will work: extraction and distillation learn in a running laboratory, under the scripted
# manager, half for their own experiments and half for its score. They begin as clones of the scripted ones, and the
# checkpoint is kept with which the laboratory scores best on seeds for that. wurtz_any has every goal of the Wurtz
# scenarios, so that its two are for all of them; accidents cost reward in wurtz_safe alone.
# From the repository's root: bash experiments/transfer.sh [RESULTS]
set -euo pipefail
results=${1:-results}

learn() { # SCENARIO STEPS EPISODES, then more arguments
    chemlab train-together "$1" --steps "$2" --rewards mixed --imitate heuristic --envs 64 --rollout 32 \
        --ent-coef 0.002 --evaluations 10 --eval-episodes "$3" --final-episodes "$3" --checkpoints 10 \
        --out "$results/$1-transfer" --quiet "${@:4}"
}

learn wurtz_any 200000 10 --roles ext --roles dit --background pretrained --imitate-steps 30000
learn wurtz_safe 100000 50 --roles ext --roles dit --background pretrained --imitate-steps 10000
for scenario in wurtz_any wurtz_safe; do
    for role in ext dit; do
        chemlab export "$results/$scenario-transfer" --role "$role" --out "agents/models/${scenario}_${role}"
    done
done
