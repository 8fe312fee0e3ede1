"""Write the JSON schemas in docs/schemas and the tables in docs/formats.md, from the classes that read the files.

Run: ``python scripts/tables/make_schemas.py``.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from castor_envs import floor
from castor_envs.description import schema_of
from castor_envs.logs.mapping import channel_map
from castor_envs.vehicles import robot, train

DOCS = Path(__file__).parents[2] / "docs"
PAGE, SCHEMAS = DOCS / "formats.md", DOCS / "schemas"
START, END = "<!-- {}: made by scripts/tables/make_schemas.py -->\n", "<!-- end of {} -->\n"
KINDS = {
    robot.FORMAT: robot.RobotDescription,
    train.FORMAT: train.TrainDescription,
    floor.FORMAT: floor.Floor,
    channel_map.FORMAT: channel_map.ChannelMap,
}
TABLES = {
    "robot": (robot.FORMAT, ("", "Castor", "Wheel", "Contact", "Gyro", "Tolerances")),
    "train": (train.FORMAT, ("", "Frame")),
    "floor": (floor.FORMAT, ("", "Patch", "Cable")),
}
"""What tables show: the file itself and the objects in it, by the names of their classes."""


def schemas() -> dict[str, dict[str, Any]]:
    """Return the schemas by the names of their files."""
    return {f"{name.replace('/', '-')}.json": schema_of(TypeAdapter(kind), name) for name, kind in KINDS.items()}


def with_tables(page: str) -> str:
    """Return the page with new tables between its marks."""
    for name, (file_format, objects) in TABLES.items():
        schema = schema_of(TypeAdapter(KINDS[file_format]), file_format)
        start, end = START.format(name), END.format(name)
        before, rest = page.split(start)
        tables = "".join(_table(schema if not part else schema["$defs"][part], part) for part in objects)
        page = before + start + tables + "\n" + end + rest.split(end)[1]
    return page


def _table(schema: dict[str, Any], name: str) -> str:
    heading = f"\n**{name}.** {schema['description'].removesuffix('.')}.\n" if name else ""
    rows = ["| key | value | default | meaning |", "|---|---|---|---|"]
    for key, entry in schema["properties"].items():
        if key == "$schema":
            continue
        default = "required" if key in schema.get("required", ()) else f"`{json.dumps(entry['default'])}`"
        if isinstance(entry.get("default"), dict):
            default = "see below"
        meaning = entry["description"].replace("None", "`null`").replace("|", "\\|")
        rows.append(f"| `{key}` | {_value(entry)} | {default} | {meaning} |")
    return heading + "\n" + "\n".join(rows) + "\n"


def _value(entry: dict[str, Any]) -> str:
    """Return in words what a value may be."""
    if "const" in entry:
        return f"`{json.dumps(entry['const'])}`"
    if "enum" in entry:
        return ", ".join(f"`{json.dumps(value)}`" for value in entry["enum"])
    if "anyOf" in entry:
        return " or ".join(_value(part) for part in entry["anyOf"])
    if "oneOf" in entry:
        return "[effect](effects.md)"
    if "$ref" in entry:
        return entry["$ref"].rpartition("/")[2].removesuffix("Description")
    match entry["type"]:
        case "array" if "prefixItems" in entry:
            return "[" + ", ".join(_value(part) for part in entry["prefixItems"]) + "]"
        case "array":
            return f"list of {_value(entry['items'])}"
        case "number" | "integer":
            low, high = entry.get("minimum", entry.get("exclusiveMinimum")), entry.get("maximum")
            above = "above " if "exclusiveMinimum" in entry else ""
            whole = "whole, " if entry["type"] == "integer" else ""
            return f"{whole}{above}{low:g} to {high:g}" if high is not None else f"{whole}{above}{low:g} or more"
        case "null":
            return "`null`"
        case other:
            return {"string": "text", "boolean": "true or false"}[other]


if __name__ == "__main__":
    SCHEMAS.mkdir(exist_ok=True)
    for file, schema in schemas().items():
        (SCHEMAS / file).write_text(json.dumps(schema, indent=2) + "\n", encoding="utf-8")
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
