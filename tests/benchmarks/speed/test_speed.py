"""The table of speed: its shape, how variants take turns, and that the page shows the stored figures."""

import importlib.util
import json
import pickle
from concurrent.futures import Future
from itertools import chain
from pathlib import Path

import pytest

from benchmarks import cli
from benchmarks.run.clusters import Cluster, contained
from benchmarks.speed import clusters, diagnosis, first_second, steps, substeps, training, updates, vectors
from benchmarks.speed import figures as measuring
from benchmarks.speed.figures import Effort, Figure, by_turns, process_cpu, ratio
from castor_envs.cli import command_line
from castor_envs.processes import Done

ROOT = Path(__file__).parents[3]


def test_variants_take_turns_and_the_first_rounds_do_not_count(monkeypatch):
    clock, order = [0.0], []
    monkeypatch.setattr(measuring.time, "process_time", lambda: clock[0])

    def taking(name, seconds):
        def work():
            order.append(name)
            clock[0] += seconds

        return work

    times = by_turns({"a": taking("a", 3.0), "b": taking("b", 2.0)}, 2, lambda: order.append("-"))
    assert "".join(order) == "-ba-ab-ba-ab"
    assert times == {"a": [3.0, 3.0], "b": [2.0, 2.0]}
    assert ratio(times, "a", "b") == 1.5


def test_figures_have_three_digits():
    numbers = {0.21876: "0.219 x", 12.34: "12.3 x", 999.4: "999 x", 999.6: "1,000 x", 7759.4: "7,760 x"}
    assert {value: Figure("", value, "x").text for value in numbers} == numbers


def test_processes_that_fail_are_named():
    assert process_cpu(["-c", "pass"], 1) > 0
    with pytest.raises(RuntimeError, match="NameError"):
        process_cpu(["-c", "unknown"], 1)


def here(slots):
    """A cluster in this process, which starts nothing."""

    def submit(function, *arguments):
        future = Future()
        if function is contained:
            called, given = pickle.loads(arguments[1])
            future.set_result(Done(called(*given)))
        else:
            future.set_result(function(*arguments))
        return future

    return Cluster(slots, submit, (), lambda: None)


def test_the_table_has_every_group(monkeypatch, capsys):
    monkeypatch.setattr(first_second, "PROCESSES", {"nothing": ["-c", "pass"]})
    monkeypatch.setattr(first_second, "RUN", ["-c", "pass"])
    for module in (steps, vectors):
        monkeypatch.setattr(module, "DRIVEN", {"differential": steps.DRIVEN["differential"]})
    monkeypatch.setattr(vectors, "SIZES", (2, 3))
    monkeypatch.setattr(vectors, "LONG", 5)
    monkeypatch.setattr(updates, "ROBOTS", 3)
    monkeypatch.setattr(training, "MEMBERS", 2)
    monkeypatch.setattr(training, "STEPS", 16)
    monkeypatch.setitem(training.PPO, "batch_size", 8)
    monkeypatch.setattr(substeps, "VEHICLES", ("differential", "cfmmr-3"))
    monkeypatch.setattr(clusters, "WAYS", (None, "loky"))
    monkeypatch.setattr(clusters, "connect", lambda way, address, processes: here(1))
    with pytest.raises(SystemExit) as leaving:
        command_line.run(cli.app, ["speed", "--rounds", "1", "--processes", "1", "--sent", "2", "--quick", "--json"])
    assert leaving.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["format"] == "castor-speed/1"
    groups = {group["title"]: group["figures"] for group in told["groups"]}
    assert list(groups) == [
        "Past this process",
        "Diagnosis",
        "The first second",
        "Steps",
        "Substeps",
        "Training",
        "Updates of estimators",
        "Vectors of environments",
    ]
    assert groups["Diagnosis"] == []
    assert (groups["Training"] == []) == (importlib.util.find_spec("stable_baselines3") is None)
    for figure in chain.from_iterable(groups.values()):
        assert figure["value"] > 0, figure
        assert figure["unit"] in ("ns", "us", "ms", "s", "x", "steps/s"), figure
    names = {figure["name"] for figure in groups["Steps"]}
    assert {"step of differential", "step of differential / 50 bare steps", "reset of differential"} <= names


def test_a_square_of_a_side_is_diagnosed(monkeypatch):
    def logs_in(arguments, processes):
        return float(len(list(Path(arguments[-1]).glob("*.csv"))))

    monkeypatch.setattr(diagnosis, "process_cpu", logs_in)
    (figure,) = diagnosis.figures(Effort(sides=(0.2,)))
    assert 0 < figure.value < 1


def test_the_pages_show_the_stored_figures(script_called):
    script = script_called("make_speed_table")
    page, stored = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert stored["format"] == "castor-speed/1"
    assert script.with_table(page, stored) == page, "run python scripts/tables/make_speed_table.py"
    page = script.CLUSTERS.read_text(encoding="utf-8")
    assert script.with_million(page, stored) == page, "run python scripts/tables/make_speed_table.py"
