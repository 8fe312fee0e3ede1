"""A small calibration task for tests: arcs of a differential robot, known in closed form."""

from dataclasses import dataclass

from fake_tasks import Arcs, arc, with_radius_error

from benchmarks.tasks.task import Calibration, Episode, Run
from estimators.calibration.protocol import Recording


@dataclass(frozen=True)
class CalibrationByArcs(Arcs):
    """Arcs both ways; in case k the robot file's wheels are 1 + k mm a metre too large."""

    name: str = "calibration-by-arcs"
    title: str = "Calibration by arcs"
    group: str = "calibration"
    followed_by: str = "dead-reckoning-1"

    def record(self, case):
        described = with_radius_error(self.robot, 1e-3 * (1 + case))
        runs = (Run(arc(-0.4, self.samples, self.robot), "cw"), Run(arc(0.4, self.samples, self.robot), "ccw"))
        recordings = [Recording(arc(0.3, 41, self.robot), side=1.0), Recording(arc(-0.3, 41, self.robot), held=1)]
        return Episode(described, runs, Calibration.by(self.followed_by, recordings, self.robot))
