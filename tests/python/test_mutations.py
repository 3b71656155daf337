"""A short run of tests/mutations/mutations.py; `make mutations` runs the whole of it."""

import importlib.util
from pathlib import Path

SCRIPT = Path(__file__).resolve().parents[1] / "mutations" / "mutations.py"


def test_damaged_files_are_errors_or_read_right():
    spec = importlib.util.spec_from_file_location("mutations", SCRIPT)
    mutations = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(mutations)
    ends, wrong = mutations.run(cases=200, seed=2)
    assert not wrong
    # All kinds came to pass, and not everything is an error.
    assert {ended.split(":")[0] for ended in ends} == set(mutations.KINDS)
    assert sum(count for ended, count in ends.items() if not ended.endswith("error")) > 10
