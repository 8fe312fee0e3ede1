"""What is wrong in a file of a robot, a train, a floor or a map: where, in words of people, and which key was meant."""

import copy
import pickle

import pytest

from castor_envs.description import InvalidDescription, place_of
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.logs import ChannelMap
from castor_envs.vehicles.load import vehicle_from_dict
from castor_envs.vehicles.presets import any_preset


@pytest.mark.parametrize(
    ("parts", "place"),
    [
        (("mass",), "mass"),
        (("contact", "friction"), "contact.friction"),
        (("castors", 1, "wheels", 0, "radius"), "castor 2, wheel 1, radius"),
        (("modules", 0, "castors", 0, "contact", "friction"), "module 1, castor 1, contact.friction"),
        (("castors", 1, "pivot", 1), "castor 2, pivot, number 2"),
        (("effects", 2, "wheel_radius", "value"), "effect 3 (wheel_radius), value"),
        (("effects", 0), "effect 1"),
        (("columns", "wheel_1l", "unit"), "columns.wheel_1l.unit"),
        (("patches", 9, "center", 0), "patch 10, center, number 1"),
        ((), ""),
    ],
)
def test_a_place_counts_from_1_in_words_of_people(parts, place):
    assert place_of(parts) == place


ROBOT, TRAIN = any_preset("asoc-prototype").to_dict(), any_preset("cfmmr-3").to_dict()
FLOOR = {"format": "castor-floor/1", "patches": [{"center": [0, 0], "size": [1, 1], "friction": 1}]}
MAP = {"format": "castor-map/1", "columns": {"wheel_1l": {"channel": "x", "unit": "m"}}}
EFFECT = {"name": "wheel_radius", "castor": 1, "wheel": 1, "value": 0.01}


@pytest.mark.parametrize(
    ("read", "data", "way", "said"),
    [
        (vehicle_from_dict, ROBOT, ("sampel_period",), "sampel_period: is not known; did you mean 'sample_period'?"),
        (vehicle_from_dict, ROBOT, ("castors", 0, "ofsett"), "castor 1, ofsett: is not known; did you mean 'offset'?"),
        (
            vehicle_from_dict,
            ROBOT,
            ("castors", 1, "wheels", 0, "radus"),
            "castor 2, wheel 1, radus: is not known; did you mean 'radius'?",
        ),
        (vehicle_from_dict, ROBOT, ("contact", "frictoin"), "contact.frictoin: is not known; did you mean 'friction'?"),
        (
            vehicle_from_dict,
            ROBOT | {"effects": [EFFECT, dict(EFFECT)]},
            ("effects", 1, "valu"),
            "effect 2 (wheel_radius), valu: is not known; did you mean 'value'?",
        ),
        (
            vehicle_from_dict,
            ROBOT | {"gyro": {}},
            ("gyro", "white"),
            "gyro.white: is not known; known: bias, bias_tolerance, bias_walk, noise, scale_tolerance",
        ),
        (
            vehicle_from_dict,
            TRAIN,
            ("modules", 1, "castors", 0, "wheels", 1, "radios"),
            "module 2, castor 1, wheel 2, radios: is not known; did you mean 'radius'?",
        ),
        (
            vehicle_from_dict,
            TRAIN,
            ("frames", 0, "length_m"),
            "frame 1, length_m: is not known; did you mean 'length'?",
        ),
        (Floor.from_dict, FLOOR, ("patches", 0, "centre"), "patch 1, centre: is not known; did you mean 'center'?"),
        (
            ChannelMap.from_dict,
            MAP,
            ("columns", "wheel_1l", "channnell"),
            "columns.wheel_1l.channnell: is not known; did you mean 'channel'?",
        ),
    ],
)
def test_of_a_key_that_is_not_known_the_one_that_may_be_meant_is_told(read, data, way, said):
    data = part = copy.deepcopy(data)
    for key in way[:-1]:
        part = part[key]
    part[way[-1]] = 1
    with pytest.raises(InvalidDescription) as caught:
        read(data, "mine.json")
    assert str(caught.value) == f"mine.json: {said}"


@pytest.mark.parametrize("given", [{}, {"name": 3}, {"name": ["wheel_radius"]}])
def test_an_effect_without_a_name_is_asked_for_it(given):
    with pytest.raises(InputError, match=r"^mine\.json: effect 1: needs a 'name', which says what it is$"):
        vehicle_from_dict(ROBOT | {"effects": [given]}, "mine.json")


def test_what_is_wrong_is_told_by_other_processes_too():
    error = InvalidDescription("mine.json", ["a: b", "c: d", "e: f", "g: h"])
    assert str(pickle.loads(pickle.dumps(error))) == str(error) == "mine.json: a: b; c: d; e: f; and 1 more"
