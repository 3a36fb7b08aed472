"""What deploy/ holds agrees with the command line and with the programs that read it."""

from __future__ import annotations

import ast
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest

from fwclass.cli import cli
from fwclass.conf.schedule import cron_rule

DEPLOY = Path(__file__).resolve().parents[1] / "deploy"
PROGRAM = "/opt/fwclass/bin/fwclass"


def files() -> list[Path]:
    return [p for p in sorted(DEPLOY.rglob("*")) if p.is_file() and "__pycache__" not in p.parts]


def test_every_command_in_deploy_is_one_of_ours():
    seen = 0
    for path in files():
        for words in re.findall(r"\bfwclass (run|schedule|history)( [^\n\"]*)", path.read_text()):
            command, rest = cli.commands[words[0]], shlex.split(words[1].split(">>")[0].split("|")[0])
            known = {name for parameter in command.params for name in parameter.opts}
            assert not [w for w in rest if w.startswith("--") and w.split("=")[0] not in known], (path, words)
            seen += "--out" in rest
    assert seen >= 4


def test_times_in_deploy_are_cron_expressions():
    text = (DEPLOY / "cron" / "fwclass").read_text()
    rules = re.findall(r"^#?((?:\S+ ){5}) ?fwclass ", text, re.M)
    rules += re.findall(r'schedule="([^"]+)"', (DEPLOY / "airflow" / "fwclass_nightly.py").read_text())
    assert len(rules) == 3 and {cron_rule(rule) for rule in rules} == {"0 3 * * *"}


def test_the_dag_is_sound_and_runs_the_same_command():
    tree = ast.parse((DEPLOY / "airflow" / "fwclass_nightly.py").read_text())
    texts = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
    assert any(text.startswith(" run ") for text in texts) and PROGRAM in texts


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd")
def test_systemd_takes_the_units(tmp_path):
    for path in (DEPLOY / "systemd").iterdir():
        text = path.read_text().replace(PROGRAM, "/bin/true")
        (tmp_path / path.name).write_text(text)
        (tmp_path / path.name.replace("@", "@x")).write_text(text)
    units = sorted(p for p in tmp_path.iterdir() if "@x" in p.name)
    assert len(units) == 3
    done = subprocess.run(["systemd-analyze", "verify", *units], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and not done.stderr.strip(), done.stderr


def test_the_image_is_made_by_the_commands_of_the_readme():
    """It is not built here: what it runs is held against what is."""
    root = DEPLOY.parent
    text = (DEPLOY / "docker" / "Dockerfile").read_text().replace("\\\n", " ")
    steps = [line.split(None, 1) for line in text.splitlines() if line and not line.startswith("#")]
    assert {step for step, _ in steps} <= {"FROM", "ARG", "ENV", "WORKDIR", "COPY", "RUN", "ENTRYPOINT"}
    assert [rest for step, rest in steps if step == "FROM"] == ["python:3.11-slim"]
    run = next(rest for step, rest in steps if step == "RUN").replace("--no-cache-dir ", "")
    install = (root / "README.md").read_text().split("## Install")[1].split("```sh\n")[1].split("```")[0]
    wanted = [c.strip() for line in install.splitlines() for c in line.split("&&") if c.strip().startswith("pip")]
    assert len(wanted) == 2 and all(command in run for command in wanted)
    assert "fwclass compile" in run and (root / "requirements.lock").is_file()
    page = (root / "docs" / "commands.md").read_text()
    assert "docker build -f deploy/docker/Dockerfile -t fwclass ." in page
