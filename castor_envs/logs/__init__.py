"""Logs: recorded, written, read, imported.

robot = load_robot("robot.json")
found = survey(open_recording("run.mcap"))          # what the recording holds, channel by channel
imported = import_log("run.mcap", robot, ChannelMap.load("map.json"))
write_log("log.csv", imported.log, robot, imported.tracked)
"""

from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.logs.mapping.channel_map import ChannelMap
from castor_envs.logs.mapping.guess import guess_map
from castor_envs.logs.mapping.import_log import Imported, import_log
from castor_envs.logs.recordings import open_recording
from castor_envs.logs.recordings.recording import survey
from castor_envs.logs.reference import TimedPoses

__all__ = [
    "ChannelMap",
    "Imported",
    "Log",
    "TimedPoses",
    "guess_map",
    "import_log",
    "open_recording",
    "read_log",
    "survey",
    "write_log",
]
