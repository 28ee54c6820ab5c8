#!/usr/bin/env bash
# Benches pretrained where they will work: extraction and distillation learn in a running laboratory, under the scripted
# manager, half for their own experiments and half for its score. They begin as clones of the scripted ones, and the
# checkpoint is kept with which the laboratory scores best on seeds for that. wurtz_any has every goal of the Wurtz
# scenarios, so that its two are for all of them. Where there is no extraction, and where purity is short of time, they
# learn on. The distillation of fictitious learns beside a scripted reaction. Where a script counts what it has done (the
# washes of salt_from_oil, the dryings of recrystallization, the minutes of wurtz_real's reaction), its clone needs a memory,
# and those learn on a bench of their own, with the vessels that laboratories bring. An hour in all. From the repository's
# root, and again to go on: bash studies/baselines/transfer.sh [RESULTS]
set -euo pipefail
results=${1:-results}

learn() { # SCENARIO STEPS EVALUATIONS EPISODES, then more arguments
    chemlab train "$1" --algo ippo --steps "$2" --evaluations "$3" --checkpoints "$3" --eval-episodes "$4" \
        --final-episodes "$4" --background pretrained --rewards mixed --envs 64 --rollout 32 --ent-coef 0.002 \
        --out "$results/$1-transfer" --quiet "${@:5}"
}

remember() { # SCENARIO BENCH ALGORITHM TURNS ROUNDS STEPS
    chemlab train "$1" --bench "$2" --starts lab --algo "$3" --memory 64 --bc scripted \
        --bc-steps "$4" --bc-rounds "$5" --steps "$6" --evaluations 4 --eval-episodes 40 --final-episodes 100 --envs 64 \
        --rollout 64 --batch-size 1024 --epochs 4 --learning-rate 1e-4 --clip-range 0.1 --ent-coef 0 \
        --out "$results/$1-$2-memory" --quiet
    chemlab export "$results/$1-$2-memory" --out "agents/models/$1_$2" --force
}

remember wurtz_real rxn recurrent-ppo 60000 10 8000
remember salt_from_oil ext maskable-recurrent-ppo 20000 2 6000
remember salt_from_oil dit maskable-recurrent-ppo 10000 2 4000
remember recrystallization cry maskable-recurrent-ppo 10000 2 5000
learn wurtz_any 120000 6 10 --roles ext --roles dit --bc scripted --bc-steps 30000
learn wurtz_dodecane_direct 20000 4 30 --roles dit --begin-from "$results/wurtz_any-transfer"
learn wurtz_scarce 10000 1 30 --roles ext --roles dit --begin-from "$results/wurtz_any-transfer"
learn fictitious 20000 4 20 --roles dit --bc scripted --bc-steps 30000 --background scripted --ent-coef 0
learn wurtz_real 200000 10 40 --background scripted,rxn=wurtz_real_rxn --roles ext --roles dit --bc scripted --bc-steps 30000 --bc-rounds 5 \
    --net-arch 128 --net-arch 128 --epochs 6 --learning-rate 1e-4 --batch-size 1024 --rollout 64 --ent-coef 0
for learned in fictitious:dit wurtz_real:ext wurtz_real:dit wurtz_any:ext wurtz_any:dit wurtz_dodecane_direct:dit wurtz_scarce:ext wurtz_scarce:dit; do
    scenario=${learned%:*} role=${learned#*:}
    chemlab export "$results/$scenario-transfer" --role "$role" --out "agents/models/${scenario}_${role}" --force
done
