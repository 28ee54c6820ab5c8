#!/usr/bin/env bash
# Every role of a scenario that draws worlds, from nothing: independent critics (IPPO), then critics that see the true state
# (MAPPO). From the repository's root, and again to go on: bash experiments/worlds_joint.sh [RESULTS [SEED ...]]
set -euo pipefail
results=${1:-results}
seeds=${*:2}
for seed in ${seeds:-0 1 2 3 4}; do
    for scenario in relay rush selectivity runaway campaign failing unlabelled crude; do
        for critic in own state; do
            folder=together$([ "$critic" = own ] || echo "-$critic")
            chemlab train-together "$scenario" --critic "$critic" --seed "$seed" --steps 200000 --envs 128 --rollout 32 \
                --batch-size 1024 --evaluations 8 --eval-episodes 100 --final-episodes 200 --checkpoints 8 \
                --out "$results/$scenario-joint/$folder/seed-$seed" --quiet
        done
    done
done
