#!/usr/bin/env bash
# Benches that learn in the running laboratory, under the scripted manager: clones of the scripted ones, half for their own
# experiments and half for the laboratory's score. From the repository's root, and again to go on:
# bash experiments/worlds_benches.sh [RESULTS [SEED ...]]
# Those of the first seed of runaway, selectivity and relay come along:
# chemlab export RESULTS/runaway-joint/benches/seed-0 --role rxn --out agents/models/runaway_rxn
set -euo pipefail
results=${1:-results}
seeds=${*:2}

turns=60000 # of each scripted bench that are shown
learn() { # SCENARIO STEPS ROLE ...
    roles=()
    for role in "${@:3}"; do
        roles+=(--roles "$role")
    done
    chemlab train-together "$1" --steps "$2" "${roles[@]}" --imitate heuristic --imitate-steps "$turns" --rewards mixed \
        --envs 128 --rollout 64 --batch-size 1024 --ent-coef 0 --evaluations 20 --eval-episodes 60 --final-episodes 100 \
        --seed "$seed" --out "$results/$1-joint/benches/seed-$seed" --quiet
}

for seed in ${seeds:-0 1 2 3 4}; do
    learn runaway 2500000 rxn
    learn relay 4000000 rxn fin
    learn rush 1500000 rxn
    learn unlabelled 300000 rxn
    learn selectivity 300000 rxn
    learn campaign 500000 rxn
    learn failing 500000 east west
    turns=20000 learn crude 300000 ext dit
done
