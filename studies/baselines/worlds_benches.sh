#!/usr/bin/env bash
# Benches that learn in the running laboratory, under the scripted manager: clones of the scripted ones, half for their own
# experiments and half for the laboratory's score. From the repository's root, and again to go on:
# bash studies/baselines/worlds_benches.sh [RESULTS [SEED ...]]
# What comes along is of earlier runs of these, and in unlabelled MAPPO's (worlds_joint.sh); others are exported so:
# chemlab export RESULTS/relay-joint/benches/seed-0 --role rxn --out agents/models/relay_rxn
set -euo pipefail
results=${1:-results}
seeds=${*:2}

bench() { # SCENARIO STEPS EPISODES ARGUMENT ...
    chemlab train "$1" --algo ippo --steps "$2" --bc scripted --rewards mixed --envs 128 --rollout 64 --batch-size 1024 \
        --ent-coef 0 --eval-episodes "$3" --final-episodes 100 --seed "$seed" --out "$results/$1-joint/benches/seed-$seed" \
        --quiet "${@:4}"
}

learn() { # SCENARIO STEPS SPREAD ROLE ...: how widely clones explore at least
    roles=()
    for role in "${@:4}"; do
        roles+=(--roles "$role")
    done
    bench "$1" "$2" 60 "${roles[@]}" --bc-steps 60000 --bc-std "$3" --evaluations 20
}

for seed in ${seeds:-0 1 2 3 4}; do
    learn runaway 2500000 0.3 rxn
    learn relay 4000000 0.3 rxn fin
    learn rush 1500000 0.3 rxn
    learn unlabelled 300000 0.3 rxn
    learn selectivity 300000 0.3 rxn
    learn campaign 500000 0.3 rxn
    learn failing 500000 0.02 east west # more widely exploring they lose what they were shown
    # With the settings above, benches of crude come to less than the scripted ones.
    bench crude 100000 100 --roles ext --roles dit --bc-steps 40000 --bc-rounds 5 --epochs 6 --net-arch 128 \
        --net-arch 128 --learning-rate 1e-4 --evaluations 10
done
