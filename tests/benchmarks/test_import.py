"""The command that writes published measurements as logs."""

import pytest

from benchmarks import cli
from castor_envs import command_line
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import load_robot

METADATA = "type,diff\nngear,12\nencRes,16\nLi,0.2\nDi,0.08,0.08\nN,1\nL,1.0\n"
RUN = "0,0,0,0,9,9\n0.05,0.1,0,0,4,6\n0.1,0.2,0,0,1,1\n"


def call(capsys, *arguments):
    """Return exit code, output and errors of the command."""
    with pytest.raises(SystemExit) as leaving:
        command_line.run(cli.app, [str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return leaving.value.code, out, err


def test_sessions_become_folders_of_a_robot_and_its_logs(tmp_path, capsys):
    folder = tmp_path / "data" / "optiodom" / "diff" / "7"
    folder.mkdir(parents=True)
    (folder / "7_metadata.csv").write_text(METADATA)
    (folder / "7_run-01.csv").write_text(RUN)
    out = tmp_path / "measured"
    code, printed, _ = call(capsys, "import", tmp_path / "data", "--out", out)
    assert code == 0
    assert printed.splitlines() == [f"{out / '7'}: OptiOdom differential drive, 1 runs"]
    assert len(read_log(out / "7" / "run-1.csv", load_robot(str(out / "7" / "robot.json")))) == 3


def test_what_no_importer_knows_is_refused_in_one_line(tmp_path, capsys):
    code, printed, said = call(capsys, "import", tmp_path, "--out", tmp_path / "out")
    assert (code, printed) == (2, "")
    assert len(said.splitlines()) == 1
    assert "no importer recognises" in said
    assert not (tmp_path / "out").exists()
