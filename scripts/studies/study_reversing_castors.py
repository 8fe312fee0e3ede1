"""How often a clean powered-caster that goes to and fro raises an alarm (docs/diagnosis-trials.md).

python scripts/studies/study_reversing_castors.py [--first 11] [--cases 8]

Its castors flip where it reverses, faster than their motors turn them, so that wheels are driven against each other.
Each case is a log of 60 s and a held-out one without any fault: once with three clean logs that wander and a reference
in all of them, once without either.
"""

import argparse
import dataclasses

from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.finder import diagnose
from discrepancy.trials.cases import Course, motion
from discrepancy.trials.pymunk_generator import drive

ROBOT, DURATION, CLEAN = preset("powered-caster"), 60.0, 10**9


def driven(course: Course, seed: int, reference: bool) -> Log:
    """Return a log of a course."""
    log = drive(ROBOT, motion(ROBOT, course, seed, DURATION), seed, duration=DURATION)
    return log if reference else dataclasses.replace(log, reference=None)


def main() -> None:
    """Print every answer, and how many are alarms or sure names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=11, help="seed of the first case")
    parser.add_argument("--cases", type=int, default=8)
    given = parser.parse_args()
    for known in (True, False):
        clean = [driven("wander", CLEAN + k, known) for k in range(3)] if known else []
        alarms, sure = 0, 0
        for seed in range(given.first, given.first + given.cases):
            log, held_out = (driven("to and fro", number, known) for number in (2 * seed, 2 * seed + 1))
            diagnosis = diagnose(ROBOT, [log], [held_out], clean)
            names = [answer.candidate.what for answer in diagnosis.answers if answer.verdict == "named"]
            alarms += diagnosis.verdict not in ("no discrepancy", "negligible")
            sure += bool(names)
            print(f"{seed}: {diagnosis.verdict}" + f": {', '.join(names)}" * bool(names), flush=True)
        print(f"{'with' if known else 'without'} clean logs and a reference: alarms {alarms}, sure names {sure}")


if __name__ == "__main__":
    main()
