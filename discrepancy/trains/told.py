"""A train's diagnosis by posterior as plain data, as that of a robot (`report.told`)."""

from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.finder import Diagnosis
from discrepancy.report.told import FORMAT, Data, answer_data, gaps
from discrepancy.trains.linearise import Linearised


def as_data(diagnosis: Diagnosis[TrainDescription, Linearised]) -> Data:
    """Return a diagnosis as plain data; lengths in m, angles in rad. Names are words already."""
    named = any(answer.verdict == "named" for answer in diagnosis.answers)
    after, held = diagnosis.after if named else None, diagnosis.held_out
    sizes = diagnosis.after.settled.sizes
    return {
        "format": FORMAT,
        "robot": diagnosis.robot.name,
        "verdict": diagnosis.verdict,
        "mistakes": [],
        "preflight": [],
        "answers": [answer_data(answer) for answer in diagnosis.answers],
        "probabilities": diagnosis.inclusion,
        "names": {name: name for name in diagnosis.inclusion},
        "gap": gaps(diagnosis.before, after),
        "held_out_gap": None if held is None else gaps(held[0], held[1] if named else None),
        "noise": None if diagnosis.before.gap is None else {"position_m": sizes.position, "heading_rad": sizes.heading},
        "replay": None,
    }
