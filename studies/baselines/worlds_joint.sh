#!/usr/bin/env bash
# Every role of a scenario that draws worlds: clones of the scripted agents that have learned from their own mistakes, too, and then learn
# together, half for their own experiments and half for the laboratory's score; with independent critics (IPPO), then with critics that
# see the true state (MAPPO). From the repository's root, and again to go on: bash studies/baselines/worlds_joint.sh [RESULTS [SEED ...]]
set -euo pipefail
results=${1:-results}
seeds=${*:2}

together() { # SCENARIO ALGORITHM STEPS ARGUMENT ...
    folder=together$([ "$2" = ippo ] || echo "-state")
    chemlab train "$1" --algo "$2" --steps "$3" --envs 128 --evaluations 8 --eval-episodes 100 --final-episodes 200 \
        --seed "$seed" --out "$results/$1-joint/$folder/seed-$seed" --quiet "${@:4}"
}

learn() { # SCENARIO TURNS STEPS: turns of each scripted agent that are shown
    for algo in ippo mappo; do
        together "$1" "$algo" "$3" --bc scripted --bc-steps "$2" --bc-rounds 5 --rewards mixed --net-arch 128 \
            --net-arch 128 --learning-rate 1e-4 --rollout 128 --batch-size 2048 --epochs 6 --ent-coef 0 --gae-lambda 0.98 --checkpoints 2
    done
}

from_nothing() { # SCENARIO
    for algo in ippo mappo; do
        together "$1" "$algo" 200000 --rollout 32 --batch-size 1024 --checkpoints 8
    done
}

for seed in ${seeds:-0 1 2 3 4}; do
    learn relay 120000 1500000
    learn rush 120000 1500000
    learn selectivity 60000 600000
    learn runaway 60000 600000
    from_nothing campaign # `learn campaign 60000 1000000` comes to less than random play: clones have no memory there
    learn unlabelled 60000 800000
    learn failing 60000 800000
    learn crude 40000 400000
done
