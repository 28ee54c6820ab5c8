#!/usr/bin/env bash
# Benches pretrained where they will work: extraction and distillation learn in a running laboratory, under the scripted
# manager, half for their own experiments and half for its score. They begin as clones of the scripted ones, and the
# checkpoint is kept with which the laboratory scores best on seeds for that. wurtz_any has every goal of the Wurtz
# scenarios, so that its two are for all of them. Where there is no extraction, and where purity is short of time, they
# learn on. Some minutes in all. From the repository's root: bash experiments/transfer.sh [RESULTS]
set -euo pipefail
results=${1:-results}

learn() { # SCENARIO STEPS EVALUATIONS EPISODES, then more arguments
    chemlab train-together "$1" --steps "$2" --evaluations "$3" --checkpoints "$3" --eval-episodes "$4" \
        --final-episodes "$4" --background pretrained --rewards mixed --envs 64 --rollout 32 --ent-coef 0.002 \
        --out "$results/$1-transfer" --quiet "${@:5}"
}

learn wurtz_any 120000 6 10 --roles ext --roles dit --imitate heuristic --imitate-steps 30000
learn wurtz_dodecane_direct 20000 4 30 --roles dit --begin-from "$results/wurtz_any-transfer"
learn wurtz_scarce 10000 1 30 --roles ext --roles dit --begin-from "$results/wurtz_any-transfer"
for learned in wurtz_any:ext wurtz_any:dit wurtz_dodecane_direct:dit wurtz_scarce:ext wurtz_scarce:dit; do
    scenario=${learned%:*} role=${learned#*:}
    chemlab export "$results/$scenario-transfer" --role "$role" --out "agents/models/${scenario}_${role}"
done
