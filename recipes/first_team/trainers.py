"""Your first team with three trainers: the reaction bench learns in the laboratory, beside two scripted partners.

In `wurtz_dodecane_direct`, a manager hands vessels to the reaction bench and to the distillation bench. Each trainer
runs PPO from random weights on the same task, with discrete actions and the reward of the bench's own experiments. The
curve is the laboratory's raw score with the greedy policy, over 20 episodes that are not used in training. A step is a
turn of the reaction bench.

    python recipes/first_team/trainers.py sb3
    python recipes/first_team/trainers.py torchrl
    python recipes/first_team/trainers.py chemlab
    python recipes/first_team/trainers.py --draw

Each of the first three takes less than a minute of one core, and writes its curve into `results` beside this file; the
last one draws them for the documentation. `sb3` and `chemlab` need the extra ``train``, `torchrl` the extra
``torchrl``, `--draw` the extra ``plot``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

from chemlab import load_scenario
from chemlab.agents.episodes import play_laboratory
from chemlab.agents.evaluate.jobs import AUDIT_SEED
from chemlab.agents.policies import make_policies
from chemlab.agents.runs import Run, versions
from chemlab.config.files import write_text
from chemlab.envs.players import as_policy
from chemlab.lab.engine import Laboratories

SCENARIO = load_scenario("wurtz_dodecane_direct").configured(actions="discrete")
HERE = Path(__file__).parent
PICTURE = HERE.parents[1] / "docs" / "images" / "first-team.png"
RESULTS = HERE / "results"
ENVS, ROLLOUT, EPOCHS, POINTS = 16, 64, 4, 10
Note = Callable[[int, float], None]


def score(policy: Any, episodes: int = 20) -> float:
    """Return the team's mean score; `policy` is a name, or a function of observations and masks for the bench."""
    labs = Laboratories(SCENARIO, episodes)
    team = make_policies(policy if isinstance(policy, str) else "scripted", labs)
    if not isinstance(policy, str):
        team["rxn_0"] = as_policy(policy)
    return float(play_laboratory(labs, team, "dodecane", AUDIT_SEED).returns.mean())


def sb3(steps: int, note: Note) -> None:
    """Train with MaskablePPO of sb3-contrib."""
    from sb3_contrib import MaskablePPO

    from chemlab.agents.background import role_vector_env
    from chemlab.agents.sb3 import ChemlabVecEnv

    envs = ChemlabVecEnv(role_vector_env(ENVS, SCENARIO, agent="rxn_0", autoreset_mode="SameStep"))
    model = MaskablePPO(
        "MlpPolicy", envs, n_steps=ROLLOUT, n_epochs=EPOCHS, batch_size=256, gamma=1.0, ent_coef=0.01,
        learning_rate=5e-4, seed=0, device="cpu",
    )  # fmt: skip
    while model.num_timesteps < steps:
        model.learn(max(steps // POINTS, 1), reset_num_timesteps=False)
        note(
            model.num_timesteps,
            score(lambda seen, mask: model.predict(seen, action_masks=mask, deterministic=True)[0]),
        )


def torchrl(steps: int, note: Note) -> None:
    """Train with TorchRL's networks, advantages and loss."""
    from tensordict import TensorDict
    from tensordict.nn import TensorDictModule
    from torchrl.envs.utils import ExplorationType, set_exploration_type
    from torchrl.modules import MLP, MaskedCategorical, ProbabilisticActor, ValueOperator
    from torchrl.objectives import ClipPPOLoss

    from chemlab.agents.torchrl.env import TorchLaboratory

    def role(*names: str) -> dict[str, Any]:
        return {name: ("rxn", name) for name in names}

    env = TorchLaboratory(ENVS, SCENARIO, roles=["rxn"], state=False, actions="discrete", seed=0)
    sizes: dict[str, Any] = {"num_cells": [128, 128], "activation_class": torch.nn.Tanh}
    inputs, actions = env.observation_spec["rxn", "observation"].shape[-1], env.action_spec["rxn", "action"].space.n
    seen = [("rxn", "observation")]
    actor = ProbabilisticActor(
        TensorDictModule(MLP(inputs, actions, **sizes), in_keys=seen, out_keys=[("rxn", "logits")]),
        in_keys={"logits": ("rxn", "logits"), "mask": ("rxn", "action_mask")},
        out_keys=[("rxn", "action")],
        distribution_class=MaskedCategorical,
        return_log_prob=True,
        log_prob_key=("rxn", "sample_log_prob"),
    )
    critic = ValueOperator(MLP(inputs, 1, **sizes), in_keys=seen, out_keys=[("rxn", "state_value")])
    loss = ClipPPOLoss(actor, critic, entropy_coeff=0.01, normalize_advantage=True)
    ended = ("done", "terminated")
    loss.set_keys(
        value=("rxn", "state_value"),
        **role("action", "sample_log_prob", "advantage", "value_target", "reward", *ended),
    )
    loss.make_value_estimator(gamma=1.0, lmbda=0.95)
    optimizer = torch.optim.Adam(loss.parameters(), lr=5e-4)

    def greedy(observation: Any, legal: Any) -> Any:
        rows = {"observation": torch.as_tensor(observation), "action_mask": torch.as_tensor(legal) > 0}
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            return actor(TensorDict({"rxn": rows}, []))["rxn", "action"].numpy()

    done, turns, data = 0, 0, env.reset()
    while turns < steps:
        with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
            data = env.rollout(4 * ROLLOUT, actor, tensordict=data, auto_reset=False, break_when_any_done=False)
            # The bench has about every fourth turn.
            follows = data[:, -1]["next"]
            for name in ended:
                data["next", "rxn", name] = data["next", name][..., None]
            loss.value_estimator(
                data, params=loss.critic_network_params, target_params=loss.target_critic_network_params
            )
        rows = data.reshape(-1)
        rows = rows[rows["rxn", "has_turn"][:, 0]]  # elsewhere there is nothing to choose
        for _ in range(EPOCHS):
            for part in torch.randperm(len(rows)).split(256):
                losses = loss(rows[part])
                optimizer.zero_grad()
                sum(losses[name] for name in ("loss_objective", "loss_critic", "loss_entropy")).backward()
                torch.nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimizer.step()
        turns, data = turns + len(rows), env.maybe_reset(follows)
        if turns >= done + steps / POINTS:
            done = turns
            note(turns, score(greedy))


def chemlab(steps: int, note: Note) -> None:
    """Train with the package's own PPO, one readable file: `agents/train/ppo.py`."""
    from chemlab.agents.train.arguments import IPPO
    from chemlab.agents.train.learn import train

    arguments = IPPO(
        scenario=SCENARIO.name, roles=("rxn",), steps=steps, envs=ENVS, rollout=ROLLOUT,
        epochs=EPOCHS, batch_size=256, practice=0.0, evaluations=POINTS, eval_episodes=20, final_episodes=1,
        play="greedy",
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        train(arguments, Path(folder) / "run")
        for point in Run(Path(folder) / "run").evaluations():
            note(point.step, point.mean)


TRAINERS = {"sb3": sb3, "torchrl": torchrl, "chemlab": chemlab}
NAMES = {"sb3": "sb3-contrib, MaskablePPO", "torchrl": "TorchRL, ClipPPOLoss", "chemlab": "chemlab train, IPPO"}


def learn(trainer: str, steps: int) -> dict[str, Any]:
    """Train; return the curve, and the scores of random and of scripted benches."""
    torch.manual_seed(0)
    torch.set_num_threads(1)  # networks this small are slower on several threads
    curve: list[list[float]] = []

    def note(step: int, mean: float) -> None:
        curve.append([step, round(mean, 4)])
        print(f"{trainer}: turn {step:,}, score {mean:.3f}", flush=True)

    begun = time.process_time()
    TRAINERS[trainer](steps, note)
    seconds = round(time.process_time() - begun)
    others = {"scripted": round(score("scripted"), 4), "random": round(score("scripted,rxn=random"), 4)}
    return {"trainer": trainer, "curve": curve, **others, "processor_s": seconds, "versions": versions()}


def draw(path: Path) -> None:
    """Draw the kept curves."""
    from chemlab.render.figure import SETTINGS, import_matplotlib, new_figure, save_figure

    with import_matplotlib().rc_context(SETTINGS):
        figure = new_figure(6.4, 3.4)
        axes = figure.subplots()
        for (trainer, name), style in zip(NAMES.items(), ("#0072B2 o", "#D55E00 s", "#009E73 ^"), strict=True):
            kept = json.loads((RESULTS / f"{trainer}.json").read_text(encoding="utf-8"))
            steps, means = zip(*[[0, kept["random"]], *kept["curve"]], strict=True)
            colour, marker = style.split()
            label = f"{name} ({kept['processor_s']} s)"
            axes.plot(steps, means, color=colour, marker=marker, markersize=4, label=label)
        axes.axhline(kept["scripted"], color="#666666", linestyle="--", linewidth=1, label="scripted bench")
        axes.set(xlabel="turns of the reaction bench", ylabel="raw score of the team")
        axes.legend(loc="lower right", frameon=False)
        axes.spines[["top", "right"]].set_visible(False)
        figure.tight_layout()
        save_figure(figure, path)


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("trainers", nargs="*", help=f"trainers to run: {', '.join(TRAINERS)}")
    parser.add_argument("--steps", type=int, default=8_000, help="turns of the reaction bench")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder for the curves")
    parser.add_argument("--draw", action="store_true", help=f"draw the kept curves into {PICTURE.name}")
    given = parser.parse_args()
    if unknown := set(given.trainers) - set(TRAINERS):
        parser.error(f"unknown trainer {', '.join(sorted(unknown))}; choose from {', '.join(TRAINERS)}")
    for trainer in given.trainers:
        found = {"command": f"python recipes/first_team/trainers.py {trainer} --steps {given.steps}"}
        found |= learn(trainer, given.steps)
        write_text(given.out / f"{trainer}.json", json.dumps(found) + "\n")
    if given.draw:
        draw(PICTURE)


if __name__ == "__main__":
    main()
