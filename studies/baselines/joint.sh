#!/usr/bin/env bash
# All that learns goes on together where the single runs ended: managers of wurtz_scarce with the reaction and the
# distillation bench (studies/paper/chemgymrl/experiments.toml, lab.toml and manager.toml come first). From the repository's root:
# bash studies/baselines/joint.sh [RESULTS]
set -euo pipefail
results=${1:-results}
for seed in 0 1 2 3 4; do
    chemlab train wurtz_scarce --algo ippo --seed "$seed" --rewards mixed --background pretrained-isolated \
        --roles manager --roles rxn --roles dit --steps 300000 --envs 128 --rollout 64 --batch-size 256 --epochs 10 \
        --learning-rate 3e-4 --gae-lambda 0.95 --ent-coef 0.005 --net-arch 64 --net-arch 64 \
        --begin-from "manager=$results/wurtz_scarce-manager_0/manager/seed-$seed,rxn=$results/WurtzReaction/ppo/seed-1,dit=$results/WurtzDistillation/ppo-both/seed-0" \
        --eval-episodes 50 --out "$results/wurtz_scarce-joint/together/seed-$seed" --quiet
done
