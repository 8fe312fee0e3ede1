"""docs/policies.md and its tutorial are true: their code runs, their figures are the stored ones, and what they say of
these holds."""

import dataclasses
import json
import re
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.leaderboard.ranking import interval

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "policies.md").read_text(encoding="utf-8")
TUTORIAL = (ROOT / "docs" / "tutorials" / "policies.md").read_text(encoding="utf-8")
FIGURES = json.loads((ROOT / "docs" / "policies.json").read_text(encoding="utf-8"))


def block(words):
    """Return the Python block of the page or its tutorial that holds these words."""
    (found,) = [code for code in re.findall(r"```python\n(.*?)```", PAGE + TUTORIAL, flags=re.S) if words in code]
    return found


@pytest.fixture(scope="module")
def made(script_called):
    return script_called("train_policies")


def test_the_scripted_driver_drives(capsys):
    exec(block("driver = env.unwrapped.follower"), {})
    said = capsys.readouterr().out
    assert f"```\n{said}```" in TUTORIAL
    earned, largest = re.findall(r"return (\S+) of at most (\S+);", said)[0]
    assert 0.8 * float(largest) < float(earned) < float(largest)


def test_an_estimator_believes_otherwise(capsys):
    exec(block("estimator="), {})
    believed, true = map(int, re.findall(r"(\d+) mm", capsys.readouterr().out))
    assert believed < true


@pytest.mark.parametrize("environment", ["castor/ASOC-v1", "castor/CFMMR-v1"])
def test_a_policy_trains_and_is_scored(made, tmp_path, monkeypatch, capsys, environment):
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed (extra 'rl')")
    monkeypatch.chdir(tmp_path)
    code, plan = block("= PPO("), made.PLANS["robot, corrections"]
    assert f"learn({plan.steps:_})" in code
    for setting in (*made.PPO.items(), ("log_std_init", plan.log_std), ("net_arch", made.NETWORK)):
        assert "{}={}".format(*setting) in code or setting in (("n_epochs", 10), ("gae_lambda", 0.95)), setting
    code = re.sub(r"learn\(.*\)", "learn(512)", code).replace("n_steps=1024", "n_steps=64")
    exec(code.replace("castor/ASOC-v1", environment), {})
    assert (tmp_path / "policy.zip").stat().st_size > 1000
    capsys.readouterr()
    exec(block("PPO.load").replace("castor/ASOC-v1", environment), {})
    assert 0 < float(capsys.readouterr().out) < 1


def test_many_at_once_train_the_same_policy():
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed (extra 'rl')")
    code = re.sub(r"learn\(.*\)", "learn(512)", block("= PPO(")).replace("n_steps=1024", "n_steps=64")
    code = code.replace("model.save", "str")
    line = re.findall(r"^env = .*\n", code, flags=re.M)
    assert len(line) == 1
    learned = []
    for script in (code, code.replace(line[0], block("num_envs=4"))):
        exec(script, names := {})
        learned.append(names["model"].policy.state_dict())
    assert all(bool((learned[0][name] == learned[1][name]).all()) for name in learned[0])


def test_many_at_once_are_trained_on():
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed (extra 'rl')")
    exec(block("GymnasiumVecEnv(envs)").replace("learn(4096)", "learn(128)").replace("n_steps=64", "n_steps=4"), {})


@pytest.mark.filterwarnings("ignore::UserWarning:minari", "ignore::ResourceWarning")
def test_a_data_set_is_recorded(tmp_path, monkeypatch, capsys):
    pytest.importorskip("minari", reason="Minari is not installed (extra 'minari')")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    exec(block("DataCollector"), {})
    assert re.fullmatch(r"3 episodes, \d{4} steps; castor/ASOC-v1\n", capsys.readouterr().out)


def test_table_and_picture_are_of_the_stored_figures(made):
    assert FIGURES["format"] == made.FORMAT
    assert made.with_table(PAGE, FIGURES) == PAGE, "run python scripts/studies/train_policies.py --draw"
    assert list(FIGURES["trained"]) == list(made.PLANS)
    for name, run in FIGURES["trained"].items():
        assert {key: run[key] for key in dataclasses.asdict(made.PLANS[name])} == dataclasses.asdict(made.PLANS[name])
        assert len(run["scores"]) == len(made.JUDGED)
    told = {"net_arch": made.NETWORK, "environments": made.ENVIRONMENTS, "seed": made.SEED}
    assert FIGURES["ppo"] == made.PPO | told
    assert FIGURES["judged_seeds"] == [made.JUDGED.start, made.JUDGED.stop]


def test_stored_scores_of_scripted_drivers_are_those_of_today(made):
    for environment, drivers in FIGURES["baselines"].items():
        env = gym.make(environment, floor=made.FLOOR)
        for name, policy in made.BASELINES.items():
            assert made.scores(env, policy, made.JUDGED[:1])[0] == pytest.approx(drivers[name][0], abs=1e-4), name


def test_scores_of_the_tutorial_are_the_stored_ones(made):
    for name, environment in (("robot, corrections", "castor/ASOC-v1"), ("train, corrections", "castor/CFMMR-v1")):
        for scores in (FIGURES["trained"][name]["scores"], FIGURES["baselines"][environment]["scripted driver"]):
            assert f"{np.mean(scores):.3f}" in TUTORIAL
    assert f"{made.PLANS['train, corrections'].steps:_}" in TUTORIAL


def test_what_the_page_says_of_training():
    trained, of = FIGURES["trained"], FIGURES["baselines"]
    robot, alone = trained["robot, corrections"], trained["robot, from nothing"]
    scripted, ahead = (np.array(of["castor/ASOC-v1"][name]) for name in ("scripted driver", "scripted, looking ahead"))
    assert np.all(np.array(robot["scores"]) > scripted)  # on every course
    assert np.mean(robot["scores"]) < np.mean(ahead)
    assert np.mean(alone["scores"]) < np.mean(scripted)
    assert all(run["cpu_s"] < 600 for run in trained.values())
    for run in trained.values():  # nobody learns to end early
        lengths = [point["episode_s"] for point in run["curve"]]
        assert np.mean(lengths[-5:]) > 0.98 * np.mean(lengths[:5])
    lengths = [point["episode_s"] for point in alone["curve"]]
    assert lengths[0] == pytest.approx(3, abs=0.5)
    assert np.mean(lengths[-5:]) == pytest.approx(8, abs=0.5)
    assert np.mean([point["score"] for point in robot["curve"][10:]]) > 0.99 * robot["curve"][-1]["score"]
    train, looking = (np.array(of["castor/CFMMR-v1"][name]) for name in ("scripted driver", "scripted, looking ahead"))
    gain = interval(np.array(trained["train, corrections"]["scores"]) - train)
    assert gain.low is not None
    assert gain.low > 0
    assert np.sum(looking < 0.5) == 1
