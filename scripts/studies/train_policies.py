"""Train policies by PPO on a slippery floor, and show how far they get beside scripted drivers.

    python scripts/studies/train_policies.py              train all, anew; needs the extra "rl"
    python scripts/studies/train_policies.py --only NAME  train one of PLANS again, keep the others
    python scripts/studies/train_policies.py --draw       make the picture and the table again from the stored figures

Writes docs/policies.json, docs/policies.png and the table of docs/policies.md. `--save FOLDER` keeps the policies, as
FOLDER/NAME.zip. One thread, one process: the same seed on the same machine gives the same policy.
"""

import argparse
import importlib.metadata
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.leaderboard.ranking import interval
from castor_envs.envs.driving.tracking import AHEAD
from castor_envs.files import write_atomically
from castor_envs.geometry.arrays import Array

DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES, PICTURE = DOCS / "policies.md", DOCS / "policies.json", DOCS / "policies.png"
START, END = "<!-- table: made by scripts/studies/train_policies.py -->\n", "<!-- end of table -->\n"
FORMAT, FLOOR, SEED = "castor-policies/1", "slippery", 0

SHOWN, JUDGED = range(20_000, 20_005), range(10_000, 10_020)
"""Seeds of the episodes that curves show, and of those that the table judges by; training sees others."""

PPO: dict[str, Any] = {
    "n_steps": 1024,
    "batch_size": 256,
    "n_epochs": 10,
    "learning_rate": 1e-3,
    "gamma": 0.98,
    "gae_lambda": 0.95,
}
"""Settings of Stable-Baselines3's PPO; of its defaults, larger steps and a sight of 2.5 s."""
NETWORK = [64, 64]
ENVIRONMENTS = 4
"""Environments that a policy is trained in, side by side."""

ROLLOUTS = 5
"""Rollouts of all environments from one point of a curve to the next."""

SOON, NEAR = 0.5, 0.015
"""s: how far the scripted driver that looks ahead does so. m: what is nearer then has no direction to drive to."""

Policy = Callable[[Any, Any], Any]


@dataclass(frozen=True)
class Plan:
    """What is trained: environment, what actions are (`control`), for how many steps; log_std: of actions, at first."""

    environment: str
    control: str
    steps: int
    log_std: float


PLANS = {
    "robot, corrections": Plan("castor/ASOC-v1", "residual", 600_000, -1.5),
    "robot, from nothing": Plan("castor/ASOC-v1", "speed", 600_000, -1.0),
    "train, corrections": Plan("castor/CFMMR-v1", "residual", 300_000, -2.0),
}


def scripted(env: Any, observation: Any) -> Any:
    """Follow the reference by `env.follower`."""
    return env.follower.action(observation)


def without_feedback(env: Any, observation: Any) -> Any:
    """Drive the reference's velocity, whatever the error."""
    return env.follower.action({**observation, "reference": np.zeros_like(observation["reference"])})


def ahead(env: Any, observation: Any) -> Any:
    """Drive so as to be in half a second where the reference will be then: straight, or if need be on an arc.

    A robot that moves in any direction needs one velocity; an axle the arc that begins ahead and leads there (pure
    pursuit), at a speed that covers its chord.
    """
    x, y, turn = observation["reference"].reshape(len(AHEAD), -1, 3)[AHEAD.index(SOON)].T
    if "rps" in observation:
        chord = np.maximum(np.hypot(x, y), 1e-3)
        speed = np.where(chord > NEAR, np.sign(x) * chord / SOON, 0.0)
        twist = np.stack([speed, np.zeros_like(speed), speed * 2 * y / chord**2], axis=-1)
    else:
        twist = np.stack([x, y, turn], axis=-1) / SOON
    aimed = {"reference": np.zeros_like(observation["reference"]), "reference_twist": twist.ravel()}
    return env.follower.action(observation | aimed)


def standing(env: Any, observation: Any) -> Any:
    """Do nothing."""
    return np.zeros(env.action_space.shape)


BASELINES: dict[str, Policy] = {
    "scripted driver": scripted,
    "scripted, without feedback": without_feedback,
    "scripted, looking ahead": ahead,
    "standing still": standing,
}


def scores(env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int]) -> Array:
    """Return the score of the episode of each seed: its return as a part of the largest possible, 0 to 1."""
    bare: Any = env.unwrapped
    found = []
    for seed in seeds:
        observation, _ = bare.reset(seed=seed)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = bare.step(policy(bare, observation))
            total += reward
            over = terminated or truncated
        found.append(total / bare.longest_episode)
    return np.array(found)


def trained(plan: Plan, save: Path | None) -> dict[str, Any]:
    """Train a policy; return its learning curve, its scores and what it took."""
    import torch
    from stable_baselines3 import PPO as Learner  # noqa: N811
    from stable_baselines3.common.callbacks import BaseCallback

    from castor_envs.envs.stable_baselines import GymnasiumVecEnv

    torch.set_num_threads(1)
    arguments = {"control": plan.control, "scaled": True, "floor": FLOOR}
    shown = gym.make(plan.environment, **arguments)
    period = shown.get_wrapper_attr("vehicle").sample_period
    curve: list[dict[str, float]] = []

    class Watch(BaseCallback):
        """Adds points to the curve."""

        def _on_step(self) -> bool:
            return True

        def _on_rollout_end(self) -> None:
            if self.num_timesteps % (ROLLOUTS * PPO["n_steps"] * ENVIRONMENTS):
                return
            lengths = [episode["l"] for episode in self.model.ep_info_buffer or ()]
            found = scores(shown, lambda _, seen: self.model.predict(seen, deterministic=True)[0], SHOWN)
            curve.append(
                {
                    "steps": self.num_timesteps,
                    "score": round(float(found.mean()), 4),
                    "episode_s": round(float(np.mean(lengths)) * period, 2),
                }
            )
            print(plan.environment, plan.control, curve[-1], flush=True)

    began = time.process_time()
    members = gym.make_vec(plan.environment, num_envs=ENVIRONMENTS, autoreset_mode="SameStep", threads=1, **arguments)
    env = GymnasiumVecEnv(members)
    network = {"net_arch": NETWORK, "log_std_init": plan.log_std}
    model = Learner("MlpPolicy", env, seed=SEED, device="cpu", policy_kwargs=network, **PPO)
    model.learn(plan.steps, callback=Watch())
    taken = time.process_time() - began
    if save is not None:
        model.save(save)
    judged = scores(shown, lambda _, seen: model.predict(seen, deterministic=True)[0], JUDGED)
    versions = {name: importlib.metadata.version(name) for name in ("stable-baselines3", "torch", "gymnasium", "numpy")}
    return {**asdict(plan), "cpu_s": round(taken), "versions": versions, "curve": curve, "scores": rounded(judged)}


def rounded(found: Array) -> list[float]:
    """Return scores as they are stored."""
    return [round(float(score), 5) for score in found]


def baselines(environment: str) -> dict[str, list[float]]:
    """Return the scores of all scripted drivers."""
    env = gym.make(environment, floor=FLOOR)
    return {name: rounded(scores(env, policy, JUDGED)) for name, policy in BASELINES.items()}


def shown_baseline(environment: str) -> float:
    """Return the mean score of the scripted driver in the episodes that curves show."""
    return round(float(scores(gym.make(environment, floor=FLOOR), scripted, SHOWN).mean()), 4)


def with_table(page: str, figures: dict[str, Any]) -> str:
    """Return the page with the table of these figures."""
    lines = [["", "driver", "score", "over the scripted driver", "PPO steps", "CPU, min"]]
    lines.append(["---", "---", "--:", "--:", "--:", "--:"])
    for environment, drivers in figures["baselines"].items():
        scripted_scores = np.array(drivers["scripted driver"])
        rows = [(name, found, None) for name, found in drivers.items()]
        rows += [
            (name, run["scores"], run) for name, run in figures["trained"].items() if run["environment"] == environment
        ]
        for name, found, run in rows:
            gain = interval(np.array(found) - scripted_scores)
            over = "" if name == "scripted driver" else f"{gain.mean:+.3f} ({gain.low:+.3f} to {gain.high:+.3f})"
            took = ["", ""] if run is None else [f"{run['steps']:,}", f"{run['cpu_s'] / 60:.1f}"]
            lines.append([f"`{environment}`", name, f"{np.mean(found):.3f}", over, *took])
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    before, rest = page.split(START)
    return before + START + "\n" + table + "\n" + END + rest.split(END, 1)[1]


def draw(figures: dict[str, Any]) -> None:
    """Draw learning curves, and how long episodes are while learning."""
    colours = dict(zip(PLANS, ("#0072b2", "#56b4e9", "#d55e00"), strict=True))
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 7), dpi=90, sharex=True, layout="constrained")
    for name, run in figures["trained"].items():
        steps = [point["steps"] / 1000 for point in run["curve"]]
        above.plot(steps, [point["score"] for point in run["curve"]], color=colours[name], label=name)
        below.plot(steps, [point["episode_s"] for point in run["curve"]], color=colours[name], label=name)
    for environment, colour in (("castor/ASOC-v1", "#0072b2"), ("castor/CFMMR-v1", "#d55e00")):
        score = figures["shown_baseline"][environment]
        above.axhline(score, color=colour, linestyle="--", linewidth=1, label=f"scripted driver, {environment}")
    above.set_ylabel("score, part of the largest return")
    above.set_ylim(0, 1)
    below.set_ylabel("length of training episodes, s")
    below.set_ylim(0, None)
    below.set_xlabel("steps, thousands")
    for axes in (above, below):
        axes.grid(color="#dddddd")
    above.legend(loc="center right", bbox_to_anchor=(1.0, 0.5), fontsize="small")
    figure.savefig(PICTURE, metadata={"Software": None})


def main() -> None:
    """Train what is asked for, store the figures, draw the picture and write the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--only", choices=PLANS, action="append", help="train this one; give it again for another")
    parser.add_argument("--draw", action="store_true", help="train nothing; make picture and table again")
    parser.add_argument("--save", type=Path, metavar="FOLDER", help="keep the trained policies here")
    given = parser.parse_args()
    names = [] if given.draw else given.only or list(PLANS)
    found = {name: trained(PLANS[name], given.save and given.save / name) for name in names}
    if given.draw:
        kept = json.loads(FIGURES.read_text(encoding="utf-8"))
    else:
        before = json.loads(FIGURES.read_text(encoding="utf-8"))["trained"] if given.only and FIGURES.exists() else {}
        environments = sorted({plan.environment for plan in PLANS.values()})
        kept = {
            "format": FORMAT,
            "floor": FLOOR,
            "judged_seeds": [JUDGED.start, JUDGED.stop],
            "ppo": PPO | {"net_arch": NETWORK, "environments": ENVIRONMENTS, "seed": SEED},
            "baselines": {environment: baselines(environment) for environment in environments},
            "shown_baseline": {environment: shown_baseline(environment) for environment in environments},
            "trained": {name: (before | found)[name] for name in PLANS if name in before | found},
        }
        write_atomically(FIGURES, json.dumps(kept, indent=1) + "\n")
    draw(kept)
    write_atomically(PAGE, with_table(PAGE.read_text(encoding="utf-8"), kept))


if __name__ == "__main__":
    main()
