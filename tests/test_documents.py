"""The documents are true: tables are those of stored results, these are what the code gives, what is named is there."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.cli import app
from benchmarks.leaderboard.ranking import interval, ranks
from benchmarks.results.references import CEILING, reference_store
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.run.worker_estimate import Failure, estimate_singly, observed_runs
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import official_tasks, select_tasks
from benchmarks.tasks.task import EVALUATION_PERIOD, MOST_SAMPLES, Run
from castor_envs.cli.commands import imported
from castor_envs.logs.log import Log
from discrepancy.trials.results.scores import wilson
from estimators.plugins.registry import load_estimator

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
FIGURES = json.loads((DOCS / "results.json").read_text(encoding="utf-8"))
BOARDS = {board["task"]: board for board in FIGURES["tasks"]}
PAGES = ("README.md", "CONTRIBUTING.md", *(str(path.relative_to(ROOT)) for path in DOCS.rglob("*.md")))
FEW_DIGITS = 1e-7
"""Relative: the stored numbers have ten digits, and limits of intervals lose some of them."""


def scores(task):
    """Return the ranking scores (cases,) of each estimator that failed in none."""
    board = BOARDS[task]
    return {entry["estimator"]: np.array(entry["by_case"]) for entry in board["estimators"] if not entry["failed"]}


def mean(task, estimator):
    return scores(task)[estimator].mean()


def rank(task):
    return {entry["estimator"]: entry["rank"] for entry in BOARDS[task]["estimators"]}


def test_tables_are_those_of_the_stored_results(script_called):
    script = script_called("make_results")
    pages = [path.read_text(encoding="utf-8") for path in script.PAGES]
    assert [script.with_tables(page, FIGURES) for page in pages] == pages, "run python scripts/tables/make_results.py"
    for name in script.TABLES:
        assert sum(page.count(script.START.format(name)) for page in pages) == 1, name


def test_how_often_paths_are_compared_is_what_runs_do():
    """And where a run is too long for that: every 3 s of 50 minutes."""
    (said,) = re.findall(
        r"Paths are compared every (\S+) s and at the end; those longer than (\d+) s .* every (\d+) s",
        (DOCS / "benchmark.md").read_text(encoding="utf-8"),
    )
    t = np.arange(0, 3001, 1.0)
    run = Run(Log(t, np.zeros((len(t), 2)), np.empty((len(t), 0)), reference=np.zeros((len(t), 3))))
    periods = (EVALUATION_PERIOD, EVALUATION_PERIOD * MOST_SAMPLES, np.median(np.diff(t[run.samples])))
    assert tuple(map(float, said)) == periods
    assert len(run.samples) == 1001


def test_the_newest_trials_are_as_few_as_have_enough_cases(script_called):
    script = script_called("make_trial_tables")
    trials = [{"judged": cases} for cases in (script.ENOUGH // 2, script.ENOUGH // 2, 20)]
    assert script.newest(trials) == trials[:2]
    assert script.newest(trials[1:]) == trials[1:]  # all together have fewer


def test_the_table_of_trials_is_that_of_the_stored_ones(script_called):
    script = script_called("make_trial_tables")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_tables(page, figures) == page, "run python scripts/tables/make_trial_tables.py"
    for trial in figures["trials"]:
        for rate in trial["rates"]:
            assert (rate["low"], rate["high"]) == pytest.approx(wilson(rate["count"], rate["total"]))


def test_a_table_of_drives_mixes_no_versions_of_an_estimator(script_called, tmp_path):
    """The version that boards show counts; where it has not run all cases, others do not fill them."""
    script = script_called("make_drive_tables")
    task = script.DrivenRobot(script.KINDS[0], next(iter(script.ROBOTS)))
    judged, beside = ResultsStore(tmp_path), reference_store(tmp_path)

    def put(store, name, version, cases, error):
        for case in cases:
            row = Row(
                task=task.name,
                version=task.version,
                estimator=name,
                source_hash=16 * version,
                case=case,
                episode=16 * "0",
                robot_hash=16 * "0",
                scores={task.metric: error},
                estimates=(np.zeros((2, 3)),),
            )
            store.save(row)

    put(judged, "wheel-odometry", "a", range(8), 0.010)
    put(beside, CEILING, "c", range(8), 0.001)
    put(judged, "filter", "b", range(8), 0.004)
    put(judged, "filter", "d", range(4), 0.002)
    with pytest.raises(ValueError, match=f"{task.name} lacks cases"):
        script.figures_of(tmp_path)
    put(judged, "filter", "d", range(8), 0.002)
    (figures,) = script.figures_of(tmp_path)["tasks"]
    assert figures["scores"] == {"wheel-odometry": 8 * [0.01], "filter": 8 * [0.002], "oracle": 8 * [0.001]}


def test_new_figures_of_drives_take_the_place_of_those_of_their_tasks(script_called):
    script = script_called("make_drive_tables")
    stored, found = (
        {"format": "f", "tasks": [{"task": name, "scores": of} for name, of in tasks]}
        for tasks in ([("a", 1), ("b", 2)], [("c", 3), ("a", 4)])
    )
    assert [(of["task"], of["scores"]) for of in script.added(stored, found)["tasks"]] == [("a", 4), ("b", 2), ("c", 3)]


def test_the_table_of_drives_is_that_of_the_stored_scores(script_called):
    script = script_called("make_drive_tables")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_table(page, figures) == page, "run python scripts/tables/make_drive_tables.py"
    ratio = {
        of["task"]: np.median(of["scores"]["wheel-odometry"]) / np.median(of["scores"]["filter"])
        for of in figures["tasks"]
    }
    redundant = ("prototype", "full-scale", "powered-caster", "swerve")
    disturbed = [ratio[f"{kind}-{on}"] for kind in ("bursts", "faults", "gyro", "fixes") for on in redundant]
    assert (round(min(disturbed), 1), round(max(disturbed))) == (2.6, 31)  # what the page says
    others = [ratio[f"{kind}-{on}"] for kind in ("gyro", "fixes") for on in ("tricycle", "omni", "differential")]
    assert (round(min(others)), round(max(others))) == (3, 7)
    worse = {name: round(1 / of, 1) for name, of in ratio.items() if name.endswith(redundant) and of < 1}
    assert worse == {"long-powered-caster": 1.3}
    better = [ratio[f"manoeuvres-{on}"] for on in redundant]
    assert (round(min(better), 1), round(max(better), 1)) == (1.2, 5.4)
    task = next(task for task in official_tasks() if task.name == "bursts-prototype")
    episode = task.record(0)
    stored = next(of["scores"]["wheel-odometry"] for of in figures["tasks"] if of["task"] == task.name)
    estimates = estimate_singly("wheel-odometry", load_estimator("wheel-odometry").source_hash, observed_runs(episode))
    assert not isinstance(estimates, Failure)
    assert score(episode, [estimates[0].poses])["ate"] == pytest.approx(stored[0], rel=1e-5)


def test_the_table_of_the_filter_is_that_of_the_stored_means(script_called):
    script = script_called("study_filter")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_table(page, figures) == page, "run python scripts/studies/study_filter.py"
    means = figures["means"]
    for board, of in means["filter"].items():  # what the page says
        assert of < means["wheel-odometry"][board], board


def test_the_tables_of_the_train_filter_are_those_of_the_stored_means(script_called):
    script = script_called("study_train_filter")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_tables(page, figures) == page, "run python scripts/studies/study_train_filter.py"
    assert (list(figures["ingredients"]), list(figures["elsewhere"])) == (list(script.VARIANTS), list(script.OTHERS))
    for name, means in figures["elsewhere"].items():  # what the page says
        assert means["train-filter"] == min(means.values()), name


def test_the_table_of_measured_boards_is_that_of_the_stored_ones(script_called):
    script = script_called("make_measured_boards")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_table(page, figures) == page, "run python scripts/tables/make_measured_boards.py"
    assert figures["format"] == script.FORMAT
    versions = {task.name: (task.version, task.metric) for task in official_tasks()}
    of = {}
    for board in figures["tasks"]:
        assert (board["version"], board["metric"]) == versions[board["task"]]
        rounding = BOARD_METRICS[board["metric"]].rounding
        scored = {entry["estimator"]: np.array(entry["by_case"]) for entry in board["estimators"] if entry["rank"]}
        assert ranks(scored, rounding) == {e["estimator"]: e["rank"] for e in board["estimators"] if e["rank"]}
        of[board["task"]] = {name: values.mean() for name, values in scored.items()}
        assert {entry["estimator"]: entry["rank"] for entry in board["estimators"]}["filter"] == 1  # as the page says
        assert of[board["task"]]["filter"] < 1.001 * min(of[board["task"]].values())
    for name in of:
        if name.endswith("-nominal"):
            assert of[name.replace("-nominal", "-calibrated")]["filter"] < 0.8 * of[name]["filter"]


def test_the_table_of_measured_robots_is_that_of_the_stored_sessions(script_called):
    script = script_called("study_measured_robots")
    page, figures = script.PAGE.read_text(encoding="utf-8"), json.loads(script.FIGURES.read_text(encoding="utf-8"))
    assert script.with_table(page, figures) == page, "run python scripts/studies/study_measured_robots.py DATA"
    assert figures["format"] == script.FORMAT
    assert len({row["session"] for row in figures["sessions"]}) == len(figures["sessions"])


def test_stored_results_are_of_the_official_tasks():
    for task in official_tasks():
        if (task.missing is None and task.standard) or task.name in BOARDS:
            board = BOARDS[task.name]
            assert (board["version"], board["metric"], board["cases"]) == (
                task.version,
                task.metric,
                list(task.cases()),
            ), "castor-bench run, then python scripts/tables/make_results.py"
    assert set(BOARDS) <= {task.name for task in official_tasks()}


@pytest.mark.parametrize("task", BOARDS)
def test_means_intervals_and_ranks_follow_from_the_cases(task):
    metric = BOARD_METRICS[BOARDS[task]["metric"]]
    for entry in BOARDS[task]["estimators"]:
        values = [value for value in entry["by_case"] if value is not None]
        assert entry["failed"] == len(entry["by_case"]) - len(values)
        if values:
            found = interval(values, metric.within)
            for number, stored in zip((found.mean, found.low, found.high), entry["scores"][metric.name], strict=True):
                assert (number is None) == (stored is None)
                assert number is None or number == pytest.approx(stored, rel=FEW_DIGITS, abs=metric.rounding)
    ranked = {name: values for name, values in scores(task).items() if rank(task)[name] is not None}
    assert ranks(ranked, metric.rounding) == {name: rank(task)[name] for name in ranked}


def test_the_page_tells_how_often_intervals_cover_and_by_how_much_results_spread(script_called):
    """Of other samples than the page's: within four standard errors of both."""
    study, page = script_called("study_ranking"), (DOCS / "benchmark.md").read_text(encoding="utf-8")
    for name, draw, mean in study.SCORES:
        (line,) = re.findall(rf"^\| {re.escape(name)} \|(.* \(.*\)) \|$", page, flags=re.M)
        told = [tuple(map(float, cell.strip(" )").split(" ("))) for cell in line.split("|")]
        for cases, stated in zip(study.SAMPLE_SIZES, told, strict=True):
            samples = draw(np.random.default_rng([9, cases]), (2000, cases))
            low, high = study.as_on_boards(samples).T
            for share, of in zip(stated, (np.mean((low <= mean) & (mean <= high)), np.mean(high < mean)), strict=True):
                assert share / 100 == pytest.approx(of, abs=4 * np.sqrt(2 * max(of, 0.01) * (1.01 - of) / 2000))
    *table, wide = study.spread_lines(FIGURES)
    assert "\n".join(table) in page
    told = re.findall(
        "`([a-z0-9-]+)`", page.partition("for the rows above 1, which are in ")[2].partition(". Ranks")[0]
    )
    assert wide == f"above 1 in: {', '.join(told)}"


AFRESH = {
    "configuration-static": ("grpec-xy", "grpec-phi", "grpec-dev", "rmspec", "train-least-squares", "train-odometry"),
    "configuration-two-of-five": ("grpec-xy", "rmspec", "inlier-least-squares"),
    "umbmark-kinematic-calibrated": ("cast-0", "ipec-1"),
    "umbmark-physics-clean": ("cast-0",),
    "umbmark-measured-nominal": ("dead-reckoning-1",),
}
"""Tasks whose first case is recorded again, with estimators that follow it."""


@pytest.mark.parametrize("name", AFRESH)
def test_a_case_recorded_and_estimated_afresh_has_the_stored_scores(name):
    measured = Path(os.environ["CASTOR_DATA"]) if "CASTOR_DATA" in os.environ else None
    (task,) = select_tasks(official_tasks(measured), [name])
    if task.missing is not None:
        pytest.skip(task.missing)
    episode = task.record(task.cases(1)[0])
    rounding = BOARD_METRICS[task.metric].rounding
    for estimator in AFRESH[name]:
        estimates = estimate_singly(estimator, load_estimator(estimator).source_hash, observed_runs(episode))
        assert not isinstance(estimates, Failure)
        found = score(episode, [estimate.poses for estimate in estimates])[task.metric]
        assert found == pytest.approx(scores(name)[estimator][0], rel=1e-6, abs=rounding)


def test_the_table_of_tasks_has_their_names_cases_and_metrics():
    page = (DOCS / "benchmark.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`[a-z].*)\|$", page.split("\n## Tasks\n")[1].split("\n## ")[0], flags=re.M)
    found = {}
    for row in rows:
        names, *_, cases, title = (cell.strip() for cell in row.split("|"))
        number = 0 if cases == "all in the folder" else int(cases.split()[0])  # without a folder there are none
        found |= {name: (number, title) for name in re.findall(r"`(.*?)`", names)}
    assert found == {task.name: (len(task.cases()), BOARD_METRICS[task.metric].title) for task in official_tasks()}


@pytest.mark.parametrize(
    "document", ["README.md", "CONTRIBUTING.md", "docs/benchmark.md", "docs/doebbler.md", "docs/trains.md"]
)
def test_paths_in_documents_exist(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    named = re.findall(
        r"(?<![\w/.-])((?:castor_envs|estimators|benchmarks|discrepancy|tests|scripts|docs)/[\w/.-]*\w)", text
    )
    assert [path for path in named if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("document", PAGES)
def test_commands_and_options_in_documents_exist(document):
    text = (ROOT / document).read_text(encoding="utf-8")
    blocks = "\n".join(re.findall(r"```bash\n(.*?)```", text, flags=re.S))
    spans = [*re.findall(r"`([^`\n]+)`", text), *re.split(r"\n|&&", blocks)]
    commands = imported(app)
    for span in spans:
        name, *words = span.split("#")[0].split() or [""]
        if name.rpartition("/")[2] == "castor-bench" and words:
            assert words[0] in commands, f"{document}: {span}"
            options = {option for parameter in commands[words[0]].params for option in parameter.opts} | {"--help"}
            assert {word for word in words if word.startswith("--")} <= options, f"{document}: {span}"


def test_what_the_pages_say_of_square_tasks():
    uncalibrated, calibrated = "umbmark-kinematic-uncalibrated", "umbmark-kinematic-calibrated"
    clean, cables, slippery = "umbmark-physics-clean", "umbmark-physics-cables", "umbmark-physics-slippery"
    all_but = {f"{name}-{castor}" for name in ("cast", "ipec") for castor in (1, 2, 3)}
    boards = (uncalibrated, calibrated, clean, cables, slippery)
    first = {task: {name for name, place in rank(task).items() if place == 1} for task in boards}
    shared = {"filter", "wheel-odometry", "holmberg-khatib"}
    assert first == {task: {"filter"} for task in boards} | {slippery: shared}
    smaller = [task for task in boards if mean(task, "holmberg-khatib") < mean(task, "cast-0")]
    assert smaller == [uncalibrated, calibrated, clean, slippery]  # what its page says
    assert mean(cables, "filter") < min(mean(cables, name) for name in all_but)
    assert mean(uncalibrated, "filter") < min(mean(uncalibrated, name) for name in all_but) / 100
    assert mean(uncalibrated, "wheel-odometry") == pytest.approx(mean(uncalibrated, "cast-0") / 2, rel=0.05)
    assert mean(calibrated, "tidybot") > 10 * mean(calibrated, "holmberg-khatib")
    for task in (uncalibrated, calibrated, clean):
        assert max(rank(task)[name] for name in ("cast-0", "cast-arc-0")) <= min(rank(task)[name] for name in all_but)
        assert mean(task, "cast-0") < min(mean(task, name) for name in all_but)
    rolling, slipping = interval(scores(calibrated)["cast-0"]), interval(scores(clean)["cast-0"])
    assert (rolling.high or 0) > (slipping.low or np.inf)
    assert slipping.mean == pytest.approx(1.25 * rolling.mean, rel=0.1)
    assert min(mean(cables, name) for name in ("cast-1", "ipec-1")) > 3 * mean(cables, "cast-0")
    assert max(mean(cables, name) for name in ("cast-2", "cast-3", "ipec-2", "ipec-3")) < mean(cables, "cast-0")
    together = [mean(slippery, name) for name in {*all_but, "cast-0", "cast-arc-0"}]
    assert max(together) < 1.1 * min(together)
    assert len({rank(slippery)[name] for name in {*all_but, "cast-0", "cast-arc-0"}}) == 1


def test_the_oracle_is_no_bound():
    """As boards and pages say: in some tasks estimators are better."""
    better = set()
    for task, board in BOARDS.items():
        oracle = [of["scores"][board["metric"]][0] for of in board["references"] if of["estimator"] == "(oracle)"]
        better |= {(name, task) for name in scores(task) for bound in oracle if mean(task, name) < bound}
    snapshots = {"configuration-one-of-three", "configuration-two-of-five"}
    assert {("train-filter", task) for task in snapshots} <= better
    pages = [*PAGES, *(str(path.relative_to(ROOT)) for path in (ROOT / "benchmarks").rglob("*.py"))]
    said = [name for name in pages if "ceiling of what" in " ".join((ROOT / name).read_text(encoding="utf-8").split())]
    assert said == []


def test_what_the_pages_say_of_calibration():
    def error(task, method, metric):
        (entry,) = (entry for entry in BOARDS[task]["estimators"] if entry["estimator"] == method)
        return entry["scores"][metric][0]

    for metric in ("radius_error", "half_track_error"):
        rolling = error("calibration-pivoting", "pivoting", metric)
        assert error("calibration-physics", "pivoting", metric) > 10 * rolling
    left = mean("calibration-umbmark", "umbmark-correction") / mean("calibration-umbmark", "uncalibrated")
    assert left == pytest.approx(1 / 8, abs=0.02)
    likelihood = mean("calibration-umbmark", "maximum-likelihood")
    assert likelihood < mean("calibration-umbmark", "umbmark-correction") / 5
    by_correction = error("calibration-umbmark", "umbmark-correction", "radius_error")
    assert error("calibration-umbmark", "maximum-likelihood", "radius_error") > by_correction
    if "calibration-measured" in BOARDS:
        assert set(rank("calibration-measured").values()) == {1}


def test_what_the_pages_say_of_trains():
    history = "configuration-history"
    snapshots = [task for task in BOARDS if task.startswith("configuration-") and task != history]
    drives = [task for task in BOARDS if task.startswith("train-")]
    assert (len(snapshots), len(drives)) == (5, 6)
    assert [name for name, place in rank(history).items() if place == 1] == ["train-filter"]
    assert scores(history)["train-filter"].max() < 0.05 / 2
    assert all(scores(history)[name].max() > 0.05 for name in scores(history) if name != "train-filter")
    for task in snapshots:
        assert rank(task)["train-filter"] == 1
        assert rank(task)["inlier-least-squares"] <= 2
    parts = []
    for task in drives:
        assert [name for name, place in rank(task).items() if place == 1] == ["train-filter"]
        parts.append(
            mean(task, "train-filter") / min(mean(task, name) for name in scores(task) if name != "train-filter")
        )
    assert (min(parts), max(parts)) == (pytest.approx(0.12, abs=0.005), pytest.approx(0.30, abs=0.005))
    for task in ("configuration-one-of-three", "configuration-two-of-five"):
        (grpec,) = (entry for entry in BOARDS[task]["estimators"] if entry["estimator"] == "grpec-xy")
        assert grpec["scores"]["sound_axle_chosen"][0] > 0.95
        assert mean(task, "grpec-xy") > mean(task, "inlier-least-squares")
        assert mean(task, "train-least-squares") > 2 * mean(task, "grpec-xy")
    least_squares = mean("configuration-small", "train-least-squares")
    assert least_squares < min(mean("configuration-small", f"grpec-{metric}") for metric in ("xy", "phi", "dev"))
    better = {
        name
        for name in scores("train-2-patch")
        if all(mean(task, name) < mean(task, "train-odometry") for task in drives if name in scores(task))
    }
    assert better == {"inlier-least-squares", "train-filter"}
    for task in drives:
        assert min(mean(task, f"grpec-{metric}") for metric in ("xy", "phi", "dev")) > mean(task, "train-odometry")
    for task in ("train-2-patch", "train-2-cables"):
        assert mean(task, "two-truck-ipec") > 5 * mean(task, "train-odometry")
