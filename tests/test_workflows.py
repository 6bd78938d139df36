"""GitHub's workflows: they parse, name what exists, and publish nothing until someone switches them on."""

import os
import re
import tomllib
from pathlib import Path

import pytest
import yaml

REPOSITORY = Path(__file__).resolve().parents[1]
WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))
TRIGGERS = {"push", "pull_request", "release", "workflow_dispatch"}


def jobs(path: Path) -> dict:
    return yaml.safe_load(path.read_text())["jobs"]


def steps(path: Path) -> list[dict]:
    return [step for job in jobs(path).values() for step in job["steps"]]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_has_the_form_that_github_reads(path):
    workflow = yaml.safe_load(path.read_text())
    assert set(workflow[True]) <= TRIGGERS  # YAML 1.1 reads the word on as true
    assert workflow["permissions"] == {"contents": "read"}
    for job in workflow["jobs"].values():
        assert job["runs-on"] == "ubuntu-latest"
        assert job["timeout-minutes"] <= 60
        names = {step["id"] for step in job["steps"] if "id" in step}
        assert set(re.findall(r"\bsteps\.(\w+)\.", str(job))) <= names
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step)
            assert re.fullmatch(r"[\w-]+/[\w-]+@[\w./-]+", step.get("uses", "a/b@c"))
    text = path.read_text()
    assert text.count("${{") == text.count("}}") == len(re.findall(r"\$\{\{ [\w.]+ \}\}", text))
    assert "secrets." not in text


def test_the_commands_of_workflows_exist():
    extras = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    found = [step["run"] for path in WORKFLOWS for step in steps(path) if "run" in step]
    assert ".ci/run" in found
    assert os.access(REPOSITORY / ".ci" / "run", os.X_OK)
    assert any(command.startswith("mkdocs build --strict") for command in found)
    for command in found:
        assert set(re.findall(r"\.\[(\w+)\]", command)) <= set(extras)


def test_nothing_is_published_until_a_variable_that_contributing_names_is_set():
    (publish,) = (path for path in WORKFLOWS if path.name == "publish.yml")
    page = (REPOSITORY / "CONTRIBUTING.md").read_text()
    for job in jobs(publish).values():
        switch = re.fullmatch(r"vars\.(\w+) == 'true'", job["if"])
        assert f"`{switch[1]}`" in page
