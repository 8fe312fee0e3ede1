# What a contributor runs. `just` lists it; each line also works by itself.

python := ".venv/bin/python"

_default:
    @just --list

# A virtual environment with all that tests and linters need.
setup:
    python3 -m venv .venv
    .venv/bin/pip install -q -e ".[test,lint]"

# All tests.
test:
    {{python}} -m pytest -q -n 2 --dist=loadfile

# The tests of what changed since REVISION, without slow ones.
fast revision="HEAD":
    {{python}} scripts/fast.py {{revision}}

# Style, spelling and types.
lint:
    .venv/bin/ruff check .
    .venv/bin/ruff format --check .
    .venv/bin/codespell
    .venv/bin/pyright --pythonpath {{python}}

# The benchmark: computes what is missing in castor-results, then shows the leaderboard.
bench *options:
    .venv/bin/castor-bench run {{options}}

# Pictures and tables of the documents that are made from the code.
docs:
    {{python}} scripts/pictures/make_architecture.py
    {{python}} scripts/tables/make_effects_table.py
    {{python}} scripts/tables/make_schemas.py

# docs/results.json and the tables of estimators, from a run of the whole benchmark.
results folder="castor-results":
    {{python}} scripts/tables/make_results.py {{folder}}
