"""From logs of a train to a report: the posterior, the residuals without and with the named effects, and the page."""

from collections.abc import Sequence

import numpy as np

from castor_envs.vehicles.load import file_name
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.finder import Diagnosis
from discrepancy.posterior.verdicts import MATERIAL, Material
from discrepancy.report.examined import Examined
from discrepancy.report.plain_data import Logs, as_data
from discrepancy.trains.linearise import Linearised, linearise
from discrepancy.trains.posterior import diagnose_train
from discrepancy.validation.sufficient import check_logs
from estimators.likelihood.trains.states import equations_of


def examine_train(
    train: TrainDescription, logs: Logs, held_out: Logs, clean: Logs, material: Material = MATERIAL
) -> Examined:
    """Return the diagnosis of a train from logs, by their names, with the content of its report.

    Residuals with the named effects are those of the train that is written, fitted to the logs again without a start.
    Raises InputError for logs that are not of this train, or that show nothing.
    """
    for given in (logs, held_out, clean):
        check_logs(given)
    diagnosis = diagnose_train(train, [*logs.values()], [*held_out.values()], [*clean.values()], material)
    return examined(train, diagnosis, logs, held_out, clean)


def examined(
    train: TrainDescription, diagnosis: Diagnosis[TrainDescription, Linearised], logs: Logs, held_out: Logs, clean: Logs
) -> Examined:
    """Return a diagnosis of a train with the content of its report."""
    found = diagnosis.found if diagnosis.found != train else None

    seen, held = (diagnosis.before, None), None if diagnosis.held_out is None else (diagnosis.held_out[0], None)
    if found is not None:
        seen = _without_and_with(train, found, logs)
        held = _without_and_with(train, found, held_out) if held_out else None
    data = as_data(diagnosis, (logs, held_out, clean), seen, held)
    named = [answer["effect"] for answer in data["answers"] if answer["verdict"] == "named"]
    data |= {
        "preflight": _remarks(diagnosis.after),
        "effects": named,
        "robot_hash": train.hash(),
        "file": file_name(train),
    }
    return Examined(data, found)


def _without_and_with(train: TrainDescription, found: TrainDescription, logs: Logs) -> tuple[Linearised, Linearised]:
    """Return the logs linearised without and with the named effects; in both, axles slide in the steps of the fit with
    them, and trains are localised with its noise."""
    train_logs, state = equations_of(found, [*logs.values()])
    without, beside = (linearise(vehicle, train_logs, state, (), localised=state.sizes) for vehicle in (train, found))
    return without, beside


def _remarks(seen: Linearised) -> Sequence[str]:
    """Return remarks on how the train was driven."""
    sliding = float(np.mean(np.concatenate([log.loose.any(axis=1) for log in seen.train_logs])))
    if not sliding:
        return []
    said = "axles are set against each other so much that some may slide in"
    return [f"{said} {100 * sliding:.0f} % of the time, which counts for little; let their wheels yield"]
