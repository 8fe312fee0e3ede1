"""docs/formats.md and the schemas beside it: up to date, and right by the judgement of `jsonschema`."""

import copy
import json
import re
from pathlib import Path

import jsonschema
import pytest

from castor_envs.effects.catalogue import catalogue
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.logs import ChannelMap
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import vehicle_from_dict
from castor_envs.vehicles.presets import any_preset, preset_names, train_names

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")
SCHEMAS = {path.name: json.loads(path.read_text()) for path in (ROOT / "docs" / "schemas").glob("*.json")}
EXAMPLES = [json.loads(block) for block in re.findall(r"```json\n(.*?)```", PAGE, flags=re.S)]
LOGS = re.findall(r"```csv\n(.*?)```", PAGE, flags=re.S)


MAPS = [
    data
    for page in ("logs.md", "tutorials/own_robot.md")
    for block in re.findall(r"```json\n(.*?)```", (ROOT / "docs" / page).read_text(encoding="utf-8"), flags=re.S)
    if (data := json.loads(block))["format"] == "castor-map/1"
]
EVERY_KEY = {
    "format": "castor-map/1",
    "sources": {"main": {"time": "t", "unit": "ms"}, "b": {"file": "b.txt", "period": 0.1, "offset": -3.0}},
    "columns": {
        "ref_psi": {"channel": ["x", "y", "z", "w"], "unit": "quaternion", "sign": 1, "source": "b"},
        "wheel_1l": {"channel": "l", "unit": "counts", "sign": -1, "scale": 2.0, "wraps_at": 65536},
    },
}
"""A map in which each key of the format stands."""


def loaded(data):
    of = {"castor-floor/1": Floor.from_dict, "castor-map/1": ChannelMap.from_dict}
    return of.get(data["format"], vehicle_from_dict)(data)


def validator(data):
    schema = SCHEMAS[f"{data['format'].replace('/', '-')}.json"]
    return jsonschema.Draft202012Validator(schema)


def accepted(data):
    """Return what the reader and the schema say of data."""
    try:
        loaded(data)
    except InputError:
        return False, validator(data).is_valid(data)
    return True, validator(data).is_valid(data)


@pytest.fixture(scope="module")
def script(script_called):
    return script_called("make_schemas")


def test_schemas_and_tables_are_up_to_date(script):
    assert script.schemas() == SCHEMAS, "run: python scripts/tables/make_schemas.py"
    assert script.with_tables(PAGE) == PAGE, "run: python scripts/tables/make_schemas.py"


@pytest.mark.parametrize("name", SCHEMAS)
def test_schemas_are_schemas_and_say_what_each_key_is(name):
    jsonschema.Draft202012Validator.check_schema(SCHEMAS[name])
    schema = SCHEMAS[name]
    objects = {"": schema, **schema["$defs"]}
    effects = {key for key, part in objects.items() if "value" in part["properties"]}
    unsaid = [
        (kind, key)
        for kind, part in objects.items()
        for key, entry in part["properties"].items()
        if kind not in effects and "description" not in entry
    ]
    assert unsaid == []


@pytest.mark.parametrize("name", [*preset_names(), *train_names()])
def test_presets_with_all_their_effects_are_valid(name):
    vehicle = any_preset(name)
    for one in (vehicle, vehicle.with_effects(*catalogue(vehicle))):
        data = json.loads(json.dumps(one.to_dict()))
        validator(data).validate(data)


@pytest.mark.parametrize("data", [*EXAMPLES, *MAPS, EVERY_KEY], ids=lambda data: data.get("name", data["format"]))
def test_examples_are_read_and_valid(data):
    assert accepted(data) == (True, True)
    assert accepted(data | {"$schema": "schemas/any.json"}) == (True, True)


def places(data, path=()):
    """Yield the paths of all values in plain data."""
    yield path
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(value, (*path, key))


@pytest.mark.parametrize("data", [*EXAMPLES, EVERY_KEY], ids=lambda data: data.get("name", data["format"]))
@pytest.mark.parametrize("wrong", [1e30, -1e30, "text", {"key": 1}, []])
def test_reader_and_schema_refuse_the_same(data, wrong):
    """Any value in its place, one at a time: both take it (a name may be any text), or both refuse it."""
    for path in places(data):
        if not path or path == ("format",):
            continue
        changed = copy.deepcopy(data)
        part = changed
        for key in path[:-1]:
            part = part[key]
        part[path[-1]] = wrong
        by_reader, by_schema = accepted(changed)
        together = path[-1] in ("modules", "frames", "wheels", "castors")  # how many, and which, only the reader judges
        assert by_reader == by_schema or (together and not by_reader), path


@pytest.mark.parametrize(
    "effect",
    [
        {"name": "pivot_bias", "castor": 1, "value": 0.01},
        {"name": "pivot_bias", "castor": 0, "value": 0.01},
        {"name": "pivot_bias", "castor": 1, "value": 1e9},
        {"name": "no_such_effect", "value": 0.0},
        {"castor": 1, "value": 0.01},
        {"name": "gauge_drift", "frame": 1, "value": 0.0},
    ],
)
def test_reader_and_schema_agree_on_effects(effect):
    data = any_preset("asoc-prototype").to_dict() | {"effects": [effect]}
    right = effect == {"name": "pivot_bias", "castor": 1, "value": 0.01}
    assert accepted(json.loads(json.dumps(data))) == (right, right)


def test_logs_of_the_page_are_read(tmp_path):
    differential, tricycle, _, train, _ = EXAMPLES
    vehicles = [vehicle_from_dict(data) for data in (differential, differential, differential, tricycle, train)]
    for text, vehicle in zip(LOGS, vehicles, strict=True):
        (tmp_path / "log.csv").write_text(text)
        log = read_log(tmp_path / "log.csv", vehicle)
        assert len(log) == 3
        assert log.extra == {}
