"""Maximum likelihood as a calibration method: parameters, standard errors, and changes that the logs do not show."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.creep import CONTROLLER
from estimators.calibration.identifiability import COVERAGE, WHOLLY, rests_on, scale_rests_on_pivots, unseen_of
from estimators.calibration.maximum_likelihood.calibrate import Calibration, calibrate
from estimators.calibration.protocol import Recording, Report, Result, names_of


class MaximumLikelihoodMethod:
    """All parameters that the logs determine, by maximum likelihood of counts and reference poses.

    pivots: whether the places of free castors' pivots are found too.
    """

    title = "maximum likelihood of all counts and reference poses"
    takes_squares = False
    finds_pivots = True

    def __init__(self, pivots: bool = False) -> None:
        self._pivots = pivots

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with the most likely parameters."""
        return self._fit(robot, recordings).calibrated

    def report(self, robot: RobotDescription, recordings: Sequence[Recording]) -> Report:
        """Return the maximum-likelihood parameters, and the changes that the logs do not show."""
        found = self._fit(robot, recordings)
        results, unseen = [], unseen_of(found)
        hidden = np.linalg.norm(found.unseen, axis=0)
        columns = (found.parameters, found.before, found.after, found.standard_errors, hidden, rests_on(found, unseen))
        for parameter, before, after, error, part, rests in zip(*columns, strict=True):
            seen = "no" if part > WHOLLY else "partly" if rests else "yes"
            resting = tuple(change.what for change in rests)
            numbers = (float(before), float(after), float(error))
            results.append(Result(parameter.name, parameter.unit, *numbers, seen, resting))
        remarks = []
        if scale_rests_on_pivots(found):
            remarks.append("all lengths rest on the pivots' places in the robot file; reference poses would check them")
        noise, (x, y, yaw) = found.noise, found.mount
        remarks.append(f"slip {1e3 * noise.along:.2g} mm along and {1e3 * noise.across:.2g} mm across after 1 m")
        if found.creeps:
            remarks.append(
                "intervals allow for creep of wheels that a controller drives against each other, assuming that its "
                f"numbers are off by {100 * CONTROLLER:.2g} % (standard deviation)"
            )
        if found.creep_left_out:
            remarks.append(
                f"creep of wheels that are driven against each other is left out ({found.creep_left_out}); if they "
                "are, numbers are off by more than their intervals"
            )
        names = [result.name for result in results]
        data: dict[str, Any] = {
            "unseen": [
                {
                    "what": change.what,
                    "shown_by": change.shown_by,
                    "moves": dict(zip(names, change.moves.tolist(), strict=True)),
                }
                for change in unseen
            ],
            "slip_m": [noise.along, noise.across],
            "creeps": found.creeps,
            "creep_left_out": found.creep_left_out,
        }
        if found.left is not None:
            before, after = found.left
            headed = found.headings > 0
            of_heading = f"{np.degrees(noise.heading):.2g} deg" if headed else "without headings"
            remarks += [
                _tracked_point(found),
                f"reference: noise {1e3 * noise.position:.2g} mm, {of_heading}",
                *(
                    f"{recording.name}: the reference is {1e3 * abs(ahead):.0f} ms "
                    f"{'ahead of' if ahead > 0 else 'behind'} the counts at the start, and gains {1e3 * rate:z.1f} ms/s"
                    for recording, (ahead, rate) in zip(recordings, found.clocks, strict=True)
                ),
                f"odometry{'' if headed else ', turned and moved to fit the positions best,'} is {1e3 * before:.1f} mm "
                f"(rms) off the reference before, {1e3 * after:.1f} mm after",
            ]
            data |= {
                "mount": {"x_m": x, "y_m": y, "psi_rad": yaw if headed else None}
                | {"standard_errors": found.mount_errors.tolist(), "seen": found.mount_seen.tolist()},
                "clocks": [{"ahead_s": ahead, "rate": rate} for ahead, rate in found.clocks.tolist()],
                "reference_noise": {
                    "position_m": noise.position,
                    "heading_rad": noise.heading if headed else None,
                },
                "odometry_rms_m": {"before": before, "after": after},
            }
        if np.isfinite(found.gyro).any():
            remarks += _gyro(found, recordings)
            of_logs = [
                None if np.isnan(bias) else {"bias_rad_s": bias, "latency_s": late}
                for bias, late in found.gyro.tolist()
            ]
            data["gyro"] = {"noise_rad_s": noise.gyro, "scale": found.gyro_scale, "logs": of_logs}
        changes = {change.what: str(change) for change in unseen}
        return Report(tuple(results), found.calibrated, changes, tuple(remarks), data)

    def _fit(self, robot: RobotDescription, recordings: Sequence[Recording]) -> Calibration:
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no fit, which is an InputError
            logs = [recording.log for recording in recordings]
            return calibrate(robot, logs, pivots=self._pivots, names=names_of(recordings))


def _gyro(found: Calibration, recordings: Sequence[Recording]) -> Iterator[str]:
    """Yield what was found of the gyro, in words."""
    yield f"gyro: noise {np.degrees(found.noise.gyro):.2g} deg/s, reads {100 * found.gyro_scale:+.2g} % of the turn"
    for recording, (bias, late) in zip(recordings, found.gyro, strict=True):
        if np.isfinite(bias):
            off = f"{np.degrees(bias):.2g} deg/s off the bias in the robot file, and {1e3 * late:z.0f} ms late"
            yield f"{recording.name}: the gyro is {off}"


def _tracked_point(found: Calibration) -> str:
    """Return the place of the tracked point in words, of positions alone without its axes; for numbers that the logs do
    not show, with the error of their prior."""
    factors, units = (1e3, 1e3, 180 / np.pi), ("mm", "mm", "deg")
    columns = zip(
        ("x", "y", "turned by"), found.mount, found.mount_errors, found.mount_seen, factors, units, strict=True
    )
    parts = [
        f"{name} {value * factor:z.{1 if unit == 'mm' else 2}f} ± {COVERAGE * error * factor:.2g} {unit}"
        + ("" if seen else " (not seen)")
        for name, value, error, seen, factor, unit in columns
        if unit == "mm" or found.headings
    ]
    return f"reference: tracked point at {', '.join(parts)}"


METHODS = {"maximum-likelihood": MaximumLikelihoodMethod}
