"""Doebbler's eqs. 1-9 and maximum likelihood on the same robots: what each leaves of Table I's parameter errors.

    python scripts/studies/compare_calibrations.py --sets 1000

The base turns once about each castor's pivot, both ways, in perfect rolling; counts are rounded; distances between
pivots are known exactly. Steady: the castors have swung in before the log begins. Swinging: they begin at random angles
and swing in, up to half a turn, while the base turns. The robots' parameters are off by Table I's errors before
calibration; the file is the preset.
"""

import argparse
import os
from concurrent.futures import ProcessPoolExecutor

import numpy as np

from benchmarks.tasks.kinematic import UNCALIBRATED_BETA
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import pivoting as turn
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration import pivoting
from estimators.calibration.maximum_likelihood.calibrate import calibrate

COLUMNS = ("eqs. 1-9, steady", "likelihood, steady", "likelihood, swinging")


def errors(found: RobotDescription, true: RobotDescription) -> list[float]:
    """Return mean absolute errors: of r_c, r_w and d in %, of beta in deg."""
    castors, wheels = zip(found.castors, true.castors, strict=True), zip(found.wheels, true.wheels, strict=True)
    of_castors = [(abs(a.offset / b.offset - 1), abs(a.pivot_zero - b.pivot_zero)) for a, b in castors]
    of_wheels = [(abs(a.radius / b.radius - 1), abs(a.lateral / b.lateral - 1)) for a, b in wheels]
    (offset, zero), (radius, lateral) = np.mean(of_castors, axis=0), np.mean(of_wheels, axis=0)
    return [100 * offset, 100 * radius, 100 * lateral, np.degrees(zero)]


def errors_of_set(k: int) -> list[list[float]]:
    """Return the errors of every column for robot k."""
    random, described = np.random.default_rng([k, 4]), preset("asoc-prototype")
    true = UNCALIBRATED_BETA.applied(described, random)
    geometry = Geometry.of(true)

    def log(rolled: Rolled) -> Log:
        encoders = Encoders(geometry, Encoders.random_phase(geometry, random))
        return Log(rolled.t, encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle))

    steady, swinging = [], []
    for held in range(1, 4):
        for way in ("cw", "ccw"):
            trajectory = turn(true.castors[held - 1].pivot, way)
            swing = roll(true, trajectory, random.uniform(-np.pi, np.pi, 3))
            again = roll(true, trajectory, swing.castor_angle[-1])
            swinging.append(log(swing))
            steady.append(pivoting.Turn(log(roll(true, trajectory, again.castor_angle[-1])), held))
    return [
        errors(pivoting.calibrate(described, steady).applied(), true),
        errors(calibrate(described, [turn_log.log for turn_log in steady]).calibrated, true),
        errors(calibrate(described, swinging).calibrated, true),
    ]


def main() -> None:
    """Print the means over all sets, with standard errors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", type=int, default=20)
    sets = parser.parse_args().sets
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        found = np.array(list(pool.map(errors_of_set, range(sets), chunksize=4)))
    mean, error = found.mean(axis=0), found.std(axis=0, ddof=1) / np.sqrt(sets)
    print(f"{sets} robots; mean absolute error left of r_c (%), r_w (%), d (%), beta (deg)")
    for name, row, off in zip(COLUMNS, mean, error, strict=True):
        print(f"{name:22s}" + "".join(f"{value:9.4f} +- {sd:.4f}" for value, sd in zip(row, off, strict=True)))
    print("r_c, eqs. 1-9 over likelihood, swinging:", f"{mean[0, 0] / mean[2, 0]:.1f}")


if __name__ == "__main__":
    main()
