"""How often the drive that castor-diagnose proposes resolves an ambiguous answer (docs/diagnosis-trials.md).

python scripts/studies/study_separating_drives.py [--cases 10] [--seed 0] [--robots differential ...]

Each case hides an effect of the catalogue, of 20 to 100 tolerances, in a log of 20 s of straight lines to and fro or of
one circle after another. Where the answer is ambiguous and a drive is proposed, the robot drives it, from its file, and
both logs are diagnosed together. It is resolved if what is hidden is named.
"""

import argparse
import dataclasses
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.effects.catalogue import catalogue
from castor_envs.logs.log import Log
from castor_envs.logs.trajectory_files import read_drive, write_drive
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.diagnose import Examined, examine
from discrepancy.hypotheses.candidates import family_of
from discrepancy.posterior.priors import same_effects
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.strength.separation import FITTED_ANYWAY

DURATION, TOLERANCES = 20.0, (20.0, 100.0)


def hidden(robot: RobotDescription, random: np.random.Generator) -> Effect:
    """Return an effect of a random class, at a random place, in a size that robots in good order do not have."""
    effects = [effect for effect in catalogue(robot) if not (effect.wiring or effect.binary)]
    effects = [effect for effect in effects if effect.name not in FITTED_ANYWAY and effect.tolerance < np.inf]
    while True:
        name = random.choice(sorted({effect.name for effect in effects}))
        of = [effect for effect in effects if effect.name == name]
        effect: Any = of[random.integers(len(of))]
        size = float(np.exp(random.uniform(*np.log(TOLERANCES))) * effect.tolerance * random.choice([-1.0, 1.0]))
        try:
            made = dataclasses.replace(effect, value=size)
            robot.with_effects(made)
        except (TypeError, ValueError):  # it has no value, or cannot have this one
            continue
        return made


def case(name: str, number: int, seed: int) -> str:
    """Return how a case ends: "broke down", "not ambiguous", "no drive", "resolved" or "not resolved"."""
    robot, random = preset(name), np.random.default_rng([seed, number])
    effect = hidden(robot, random)
    course, real = random.choice(["to and fro", "circles"]), robot.with_effects(effect)
    log = drive(real, motion(robot, course, number, DURATION), 2 * number, duration=DURATION)
    first = examined(robot, {"first": log})
    if first is None:
        return "broke down"
    sets = [answer["credible_set"] for answer in first.data["answers"] if answer["verdict"] == "ambiguous"]
    if not sets:
        return "not ambiguous"
    truth = same_effects(robot)[0].get(family_of(effect), family_of(effect))
    print(f"{number} {name}, {course}: {truth} {effect}: ambiguous: {sets}", flush=True)
    if not first.drives:
        print("  no drive is proposed", flush=True)
        return "no drive"
    best = max(first.drives, key=lambda proposed: proposed.expected)
    with tempfile.TemporaryDirectory() as folder:
        write_drive(Path(folder) / "drive.csv", best.trajectory, robot.sample_period)
        asked = read_drive(Path(folder) / "drive.csv")
    second = drive(real, asked, 2 * number + 1, duration=asked.duration)
    both = examined(robot, {"first": log, "second": second})
    answers = [] if both is None else both.data["answers"]
    names = [answer["credible_set"][0] for answer in answers if answer["verdict"] == "named"]
    print(f"  {best.what} ({best.expected:.3g}): named {names}, {truth in names}", flush=True)
    return "resolved" if truth in names else "not resolved"


def examined(robot: RobotDescription, logs: dict[str, Log]) -> Examined | None:
    """Return what logs say; None where the finder breaks down, which is reported."""
    try:
        return examine(robot, logs, {}, {})
    except (ValueError, np.linalg.LinAlgError) as error:
        print(f"  {' and '.join(logs)}: the finder broke down: {error!r}", flush=True)
        return None


def main() -> None:
    """Print every ambiguous case, and how many cases end how."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=10, help="ambiguous ones for which a drive is proposed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robots", nargs="+", default=["differential", "asoc-prototype"])
    options = parser.parse_args()
    ends, number = Counter[str](), 0
    while ends["resolved"] + ends["not resolved"] < options.cases:
        number += 1
        ends[case(options.robots[number % len(options.robots)], number, options.seed)] += 1
    print(f"{number} logs: {', '.join(f'{count} {end}' for end, count in ends.most_common())}")


if __name__ == "__main__":
    main()
