"""Which tests `pytest --unchanged` leaves out."""

import json
import subprocess
import sys
from types import SimpleNamespace

import pytest

import unchanged
from unchanged import ROOT, TESTS, Unchanged, digest, names_used

QUICK = "tests/docs/test_examples.py"


def depends_on(test: str) -> set[str]:
    """Packages that a test file depends on."""
    names = names_used(TESTS / test)
    assert names is not None
    return {module.split(".")[1] for module in unchanged.sources.modules(" ".join(sorted(names))) if "." in module}


def test_files_depend_on_what_they_use():
    assert not depends_on("rod/test_rod.py") & {"_path", "_scan", "plot"}
    assert "_path" in depends_on("physics/test_reference_scans.py")  # through `jw.scan`
    assert not depends_on("physics/test_reference_scans.py") & {"plot", "film", "_inverse", "cli"}
    assert {"plot", "_scan"} <= depends_on("plot/test_states.py")
    assert "_chain" in depends_on("chain/test_landing.py")  # through helpers


@pytest.mark.parametrize("test", ["docs/test_layout.py", "base/test_store.py", "inverse/test_saving.py"])
def test_files_that_may_look_at_any_other_depend_on_all(test):
    assert names_used(TESTS / test) is None


EDITS = {"_rod.rod": [True, True, False], "_path.march": [False, True, False], "_file.toml": [False] * 3}


@pytest.mark.parametrize("module", EDITS)
def test_edits_change_the_digests_of_what_depends_on_them(module, monkeypatch):
    """Digests of three files: the last one depends on files, not on their imports."""
    files = [TESTS / name for name in ("rod/test_rod.py", "physics/test_reference_scans.py", "docs/test_layout.py")]

    def digests():
        for cached in (digest, unchanged.sources.digest, unchanged.sources._digest):
            cached.cache_clear()
        return [digest(path, False) for path in files]

    before, original = digests(), unchanged.sources._source
    edited = f"jaxwhisker.{module}"
    monkeypatch.setattr(unchanged.sources, "_source", lambda name: original(name) + "# edited" * (name == edited))
    assert [one != other for one, other in zip(before, digests(), strict=True)] == EDITS[module]
    monkeypatch.undo()
    assert digests() == before and digest(files[0], True) != digest(files[0], False)


def test_only_tests_that_have_passed_are_left_out(tmp_path):
    plugin, records = Unchanged(tmp_path / "passed.json", typed=False, worker=True), tmp_path / "passed.json"
    names = [f"{QUICK}::{name}" for name in ("good", "bad", "broken", "skipped", "new")]
    items = [SimpleNamespace(nodeid=name) for name in names]
    for name, outcomes in zip(names, ([1, 1, 1], [1, 0, 1], [1, 1, 0], [0, 1], []), strict=True):
        for passed in outcomes:
            plugin.pytest_runtest_logreport(SimpleNamespace(nodeid=name, passed=bool(passed)))
    session = SimpleNamespace(config=SimpleNamespace(), exitstatus=pytest.ExitCode.TESTS_FAILED)
    plugin.pytest_sessionfinish(session)
    assert session.exitstatus == pytest.ExitCode.TESTS_FAILED
    deselected = []
    hook = SimpleNamespace(pytest_deselected=lambda items: deselected.extend(items))
    plugin.pytest_collection_modifyitems(SimpleNamespace(hook=hook), rest := [*items])
    assert [item.nodeid for item in deselected] == names[:1] and rest == items[1:]
    records.write_text(json.dumps({names[0]: "another digest"}))
    plugin.pytest_collection_modifyitems(SimpleNamespace(hook=hook), rest := [*items])
    assert rest == items


def test_a_second_run_repeats_nothing(tmp_path):
    def run():
        options = ["-n", "1", f"--unchanged={tmp_path / 'passed.json'}", "-k", "zeros"]
        command = [sys.executable, "-m", "pytest", *options, "tests/base/test_quaternions.py"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout.splitlines()[-2:]

    code, _ = run()
    assert code == 0
    code, (said, _) = run()
    assert code == 0 and "were left out" in said
