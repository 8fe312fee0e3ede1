"""Estimators are found by name, module or file; what is wrong with a spec is said in one line."""

import dataclasses
import importlib.metadata
import importlib.util
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import estimators
from castor_envs.errors import Declined, InputError
from castor_envs.vehicles.presets import cfmmr, preset, preset_names
from estimators import CAST, IPEC, CASTArc, DeadReckoning, Estimator, WheelOdometry, builtin_names, load_estimator
from estimators.plugins.drives import winding
from estimators.plugins.registry import ESTIMATOR, declines
from estimators.plugins.source_hash import source_files

WPILIB = " wpilib-swerve wpilib-swerve-midpoint" if importlib.util.find_spec("wpimath") else ""
"""What the optional wheel `robotpy-wpimath` adds."""

MINE = """
import numpy as np

class Mine:
    def reset(self, robot, pose):
        self.pose = np.array(pose, dtype=float)

    def update(self, observation):
        return self.pose.copy()
"""


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    """Every test in a folder of its own, with import paths and modules put back afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    before = set(sys.modules)
    yield
    for name in set(sys.modules) - before:
        del sys.modules[name]


@pytest.mark.parametrize(
    ("spec", "kind", "attributes"),
    [
        ("dead-reckoning", DeadReckoning, {"castor": 1}),
        ("dead-reckoning-3", DeadReckoning, {"castor": 3}),
        ("ipec-2", IPEC, {"left_out": 2}),
        ("cast", CAST, {"left_out": 0}),
        ("cast-0", CAST, {"left_out": 0}),
        ("cast-1", CAST, {"left_out": 1}),
        ("cast-arc", CASTArc, {"left_out": 0}),
        ("cast-arc-2", CASTArc, {"left_out": 2}),
        ("wheel-odometry", WheelOdometry, {}),
        ("estimators.robots.cast:CAST", CAST, {"left_out": 0}),
    ],
)
def test_builtin_by_name(spec, kind, attributes):
    entry = load_estimator(spec)
    estimator = entry.factory()
    assert type(estimator) is kind
    assert {name: getattr(estimator, name) for name in attributes} == attributes
    assert entry.name == spec
    assert entry.batched
    assert entry.factory() is not estimator


@pytest.mark.parametrize(
    ("robot", "names"),
    [
        (
            "asoc-prototype",
            "cast-1 cast-2 cast-3 cast-0 cast-arc-0 dead-reckoning-1 filter holmberg-khatib ipec-1 ipec-2 ipec-3"
            f" module-mean skid-ratio tidybot wheel-odometry{WPILIB}",
        ),
        (
            "omnimate",
            "cast-0 cast-arc-0 dead-reckoning-1 filter holmberg-khatib ipec-0 module-mean skid-ratio tidybot"
            f" wheel-odometry{WPILIB}",
        ),
        (
            "4-castor",
            "cast-1 cast-2 cast-3 cast-4 cast-0 cast-arc-0 dead-reckoning-1 filter holmberg-khatib module-mean"
            f" skid-ratio tidybot wheel-odometry{WPILIB}",
        ),
        ("differential", "dead-reckoning-1 filter holmberg-khatib tidybot wheel-odometry"),
        ("swerve", f"filter holmberg-khatib module-mean skid-ratio tidybot wheel-odometry{WPILIB}"),
    ],
)
def test_builtin_names_are_those_that_apply(robot, names):
    assert builtin_names(preset(robot)) == names.split()


@pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")
@pytest.mark.parametrize("robot", preset_names())
def test_applicable_says_what_reset_would(robot):
    robot = preset(robot)
    for spec in ("dead-reckoning", "ipec", "ipec-1", "cast", "cast-4", "cast-arc", "wheel-odometry", "tidybot"):
        entry = load_estimator(spec)
        reason = entry.applicable(robot)
        if reason is None:
            entry.factory().reset(robot, np.zeros(3))
        else:
            with pytest.raises(InputError) as refusal:
                entry.factory().reset(robot, np.zeros(3))
            assert str(refusal.value) == reason


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("csat", r"unknown estimator 'csat'; did you mean 'cast'\?"),
        ("csat-2", r"unknown estimator 'csat-2'; did you mean 'cast-2'\?"),
        ("ipec-x", r"unknown estimator 'ipec-x'; did you mean 'ipec'\?"),
        ("zzz", "known: cast, cast-arc, dead-reckoning, .*, ipec, .*, two-truck-ipec"),
        ("", "unknown estimator ''"),
        ("mine.py", r"mine\.py: cannot be read"),
        ("folder/mine.py:Mine", r"folder/mine\.py: cannot be read"),
        ("nowhere:Mine", "cannot be imported .ModuleNotFoundError"),
        (":Mine", "expected module:Class"),
        ("estimators.robots.cast:", "expected module:Class"),
        ("estimators.robots.cast:CASTT", r"no class 'CASTT'; did you mean 'CAST'\?"),
        ("estimators.robots.cast:design_matrix", "'design_matrix' is not a class"),
    ],
)
def test_unknown_spec_says_what_to_do(spec, message):
    with pytest.raises(InputError, match=message):
        load_estimator(spec)


@pytest.mark.parametrize("spec", ["mine.py", "./mine.py", "mine.py:Mine", "mine:Mine"])
def test_plugin_from_file_or_module_in_the_current_folder(spec):
    Path("mine.py").write_text(MINE)
    entry = load_estimator(spec)
    assert entry.name == "mine:Mine"
    assert not entry.batched
    assert not entry.builtin
    assert entry.applicable(preset("swerve")) is None
    estimator = entry.factory()
    assert isinstance(estimator, Estimator)
    estimator.reset(preset("asoc-prototype"), np.ones(3))
    np.testing.assert_array_equal(estimator.update({}), np.ones(3))
    assert not Path("__pycache__").exists() or spec == "mine:Mine"


@pytest.mark.parametrize(("file", "built_in"), [("cast.py:CAST?step=euler", "cast-0?step=euler"), ("ipec.py", "ipec")])
def test_a_copy_of_a_builtins_file_gives_its_poses(file, built_in):
    """So authors begin: each builds on a compiled kernel."""
    copied = file.partition(".py")[0] + ".py"
    shutil.copy(Path(estimators.__file__).parent / "robots" / copied, copied)
    drive, poses = winding(preset("omnimate")), []
    for spec in (file, built_in):
        estimator = load_estimator(spec).factory()
        estimator.reset(preset("omnimate"), np.zeros(3))
        poses.append([estimator.update(observation).copy() for observation in drive.observations])
    np.testing.assert_array_equal(*poses)


def test_plugin_from_absolute_path_may_import_its_neighbours(tmp_path):
    folder = tmp_path / "elsewhere"
    folder.mkdir()
    (folder / "neighbour_of_mine.py").write_text("START = 7.0\n")
    (folder / "mine.py").write_text("from neighbour_of_mine import START\n" + MINE)
    before = load_estimator(str(folder / "mine.py"))
    assert before.factory() is not None
    (folder / "neighbour_of_mine.py").write_text("START = 8.0\n")
    assert load_estimator(str(folder / "mine.py")).source_hash != before.source_hash


def test_plugins_with_neighbours_of_one_name_are_not_mixed_up(tmp_path):
    for folder in (tmp_path / "a", tmp_path / "b"):
        folder.mkdir()
        (folder / "shared_name.py").write_text(f"NAME = {folder.name!r}\n")
        (folder / "mine.py").write_text("import shared_name\n" + MINE)
    load_estimator("a/mine.py")
    with pytest.raises(InputError, match="another plug-in has loaded"):
        load_estimator("b/mine.py")


@pytest.mark.parametrize(
    ("source", "message"),
    [
        ("x = 1\ny = nothing_known\n", "cannot be imported, line 2 .NameError: name 'nothing_known' is not defined"),
        ("def update(:\n", "cannot be imported, line 1 .SyntaxError"),
        ("import no_such_package\n", "cannot be imported, line 1 .ModuleNotFoundError: No module named"),
        ("import sys\nsys.exit('bye')\n", "cannot be imported, line 2 .SystemExit: bye"),
        ("x = 1\n", "there is no class in it; an estimator is a class with reset and update"),
        ("class Mine:\n    def reset(self, robot, pose): ...\n", "class Mine has no method update"),
        ("class Mine:\n    def update(self, observation): ...\n", "class Mine has no method reset"),
        ("class Mine: ...\n", "class Mine has no method reset and no update"),
        (MINE + "\nclass Other(Mine): ...\n", r"say which class, as mine\.py:Mine; there are Mine, Other"),
    ],
)
def test_plugin_file_that_is_wrong_says_where(source, message):
    Path("mine.py").write_text(source)
    with pytest.raises(InputError, match=message) as refusal:
        load_estimator("mine.py")
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("with_init", [True, False])
def test_a_file_that_imports_relatively_is_named_as_a_module(with_init):
    folder = Path("some_package_of_mine")
    folder.mkdir()
    (folder / "start.py").write_text("START = 1.0\n")
    (folder / "mine.py").write_text("from .start import START\n" + MINE)
    if with_init:
        (folder / "__init__.py").write_text("")
    with pytest.raises(InputError) as refusal:
        load_estimator("some_package_of_mine/mine.py:Mine")
    named, _, where = str(refusal.value).partition("name it as ")[2].partition(", ")
    assert (named, where) == ("some_package_of_mine.mine:Mine", "in the folder that holds some_package_of_mine")
    assert load_estimator(named).name == named


def test_file_with_several_classes_serves_the_one_named():
    Path("mine.py").write_text(MINE + "\nclass Other(Mine): ...\n\nclass Settings: ...\n")
    assert load_estimator("mine.py:Other").kind.__name__ == "Other"
    with pytest.raises(InputError, match=r"did you mean 'Other'\?"):
        load_estimator("mine.py:Otter")


def test_imported_classes_are_not_taken_for_the_plugin():
    Path("mine.py").write_text("from estimators import CAST\n" + MINE)
    assert load_estimator("mine.py").kind.__name__ == "Mine"


def test_number_for_a_class_that_takes_none_is_refused(monkeypatch):
    monkeypatch.setattr(CAST, "__init__", lambda self: None)
    with pytest.raises(InputError, match="takes no number; leave out '-2'"):
        load_estimator("cast-2")


def test_edited_plugin_is_loaded_anew_with_another_hash():
    """At once, though the file has the same size and perhaps the same time stamp."""
    Path("mine.py").write_text(MINE)
    old = load_estimator("mine.py")
    Path("mine.py").write_text(MINE.replace("self.pose.copy()", "self.pose + 1.0"))
    new = load_estimator("mine.py")
    assert new.source_hash != old.source_hash
    for entry, expected in ((old, 0.0), (new, 1.0)):
        estimator = entry.factory()
        estimator.reset(preset("asoc-prototype"), np.zeros(3))
        assert estimator.update({})[0] == expected


def test_hash_knows_class_number_and_content_but_not_the_place():
    Path("mine.py").write_text(MINE + "\nclass Other(Mine): ...\n")
    Path("sub").mkdir()
    shutil.copy("mine.py", "sub/mine.py")
    hashes = {
        spec: load_estimator(spec).source_hash
        for spec in ("mine.py:Mine", "sub/mine.py:Mine", "mine.py:Other", "cast-1", "cast-2", "ipec-1")
    }
    assert hashes["mine.py:Mine"] == hashes["sub/mine.py:Mine"]
    assert len(set(hashes.values())) == 5
    assert all(len(value) == 16 and int(value, 16) >= 0 for value in hashes.values())


def test_edited_builtin_has_another_hash(tmp_path):
    """Its own file or one it builds on; not one it does not use."""
    package = tmp_path / "estimators"
    shutil.copytree(Path(estimators.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    # The project's folder comes from the parent's path, so that this works with and without an installation.
    code = (
        f"import sys; sys.path[:] = {[str(tmp_path), *sys.path]!r}\n"
        "import estimators.plugins.source_hash as s, estimators as e\n"
        f"assert e.__file__.startswith({str(tmp_path)!r})\n"
        "for edited in [None, *sys.argv[1:]]:\n"
        "    if edited:\n"
        "        with open(edited, 'a') as file: file.write('# edited\\n')\n"
        "    print(s.source_hash(e.CAST), s.source_hash(e.IPEC))\n"
    )

    def hashes(*edits):
        command = [sys.executable, "-c", code, *(str(package / file) for file in edits)]
        lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
        return [line.split() for line in lines]

    (cast, ipec), after_ipec, after_both = hashes("robots/ipec.py", "steps/castor_odometry.py")
    assert after_ipec[0] == cast
    assert after_ipec[1] != ipec
    assert after_both[0] != cast
    assert hashes() == [after_both]


def test_plugin_that_builds_on_a_builtin_shares_its_edits():
    Path("mine.py").write_text("from estimators.robots.cast import CAST\n\nclass Mine(CAST):\n    pass\n")
    entry = load_estimator("mine.py")
    assert entry.batched
    names = {file.name for file in source_files(entry.kind)}
    assert names == {"mine.py", "cast.py", "castor_odometry.py", "stacked.py", "protocol.py"}


def test_package_plugin_is_hashed_with_what_it_imports_of_its_package():
    for name, text in {
        "__init__.py": "",
        "core.py": "from .deep import K\n",
        "unused.py": "",
        "deep/__init__.py": "from some_package.deep.inner import K\n",
        "deep/inner.py": "K = 1\n",
        "mine.py": "import numpy\nfrom . import core\n" + MINE,
    }.items():
        file = Path("some_package") / name
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
    Path("numpy.py").write_text("")
    entry = load_estimator("some_package.mine:Mine")
    files = source_files(entry.kind)
    relative = {file.relative_to(Path("some_package").resolve()).as_posix() for file in files}
    assert relative == {"__init__.py", "mine.py", "core.py", "deep/__init__.py", "deep/inner.py"}


@pytest.mark.parametrize("spec", ["cast-1", "mine.py", "mine:Mine"])
def test_entry_pickles_as_its_spec(spec):
    Path("mine.py").write_text(MINE)
    entry = load_estimator(spec)
    again = pickle.loads(pickle.dumps(entry))
    assert (again.name, again.spec, again.source_hash) == (entry.name, spec, entry.source_hash)
    assert again.factory() is not None


def test_a_name_declared_by_two_packages_is_refused(tmp_path, monkeypatch):
    for name, target in (("one", "one_mod:A"), ("two", "two_mod:B")):
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[castor.estimators]\ntwice = {target}\nonly-{name} = {target}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    Path("one_mod.py").write_text(MINE.replace("Mine", "A"))
    with pytest.raises(InputError, match="declared twice, as one_mod:A and two_mod:B"):
        load_estimator("twice")
    assert load_estimator("only-one").kind.__name__ == "A"
    with pytest.raises(InputError, match=r"only-two.*cannot be imported .ModuleNotFoundError"):
        load_estimator("only-two")
    with pytest.raises(InputError, match="takes no number"):
        load_estimator("only-one-3")


def test_entry_points_are_searched_once_a_process(tmp_path, monkeypatch):
    searches, search = [], importlib.metadata.entry_points
    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda **given: searches.append(given["group"]) or search(**given)
    )
    monkeypatch.syspath_prepend(str(tmp_path))  # another path is searched again
    for spec in ("cast-0", "ipec-1", "cast-0"):
        load_estimator(spec)
    assert sorted(searches) == sorted(set(searches)) != []


def test_file_named_without_its_ending_is_suggested(tmp_path):
    (tmp_path / "mean_castor.py").write_text(MINE)
    with pytest.raises(InputError, match=r"unknown estimator 'mean_castor'; did you mean the file 'mean_castor.py'\?"):
        load_estimator("mean_castor")


@pytest.mark.parametrize("spec", ["grpec-xy-0", "rmspec-99999999999", "two-truck-ipec-0"])
def test_an_interval_that_is_none_is_the_commands_mistake(spec):
    with pytest.raises(InputError, match=f"estimator '{spec}': the interval between corrections"):
        load_estimator(spec)


def test_what_only_the_other_kind_of_vehicle_has_declines_it():
    robot, train = preset("differential"), cfmmr(3)

    def reason(vehicle, name):
        try:
            getattr(vehicle, name)
        except AttributeError as error:
            return declines(error, vehicle)

    assert reason(train, "castors") == "is written for robots: it asks for 'castors'"
    assert reason(train, "driven_wheels") == "is written for robots: it asks for 'driven_wheels'"
    assert reason(robot, "modules") == "is written for trains: it asks for 'modules'"
    assert reason(robot, "no_such_thing") is None
    assert declines(AttributeError("castors", name="castors", obj=object()), train) is None
    assert declines(KeyError("castors"), train) is None
    assert declines(InputError("the poses to start at are not finite"), train) is None
    assert declines(Declined("needs\n robots"), train) == "needs robots"


def test_what_a_module_offers_must_be_a_class(monkeypatch):
    role = dataclasses.replace(ESTIMATOR, packages=("offering",))
    monkeypatch.setattr("estimators.plugins.find.offers", lambda package, constant: [{"mine": np.zeros}])
    with pytest.raises(InputError, match=r"ESTIMATORS offers as 'mine' .*, which is not a class; give the class"):
        role.built_in  # noqa: B018
