"""No kernel leaves its arrays, whatever it is given: hostile inputs, every place of every array looked at.

200 000 waveforms: ``python tests/bounds/child.py checked decompose 50000 SEED`` of four seeds, two CPU minutes each.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import laspy
import pytest
from commandline import process

CHILD = Path(__file__).with_name("child.py")


def drive(how: str, room: str, inputs: int, seed: int = 1) -> None:
    line = [sys.executable, str(CHILD), how, room, str(inputs), str(seed)]
    ended = subprocess.run(line, capture_output=True, text=True, timeout=1800)
    assert ended.returncode == 0, ended.stderr[-3000:]
    assert f"{room}: {inputs} inputs" in ended.stdout


@pytest.mark.slow
def test_kernels_of_decompose():
    drive("python", "decompose", 12)


@pytest.mark.parametrize(("room", "inputs"), [("packets", 120), ("pulses", 40)])
def test_kernels_of_formats(room, inputs):
    drive("python", room, inputs)


@pytest.mark.slow
def test_compiled_kernels_of_decompose():
    drive("checked", "decompose", 600)


@pytest.mark.slow
@pytest.mark.parametrize(("room", "inputs"), [("points", 120), ("forest", 400), ("packets", 20_000), ("pulses", 4_000)])
def test_compiled_kernels_of(room, inputs):
    drive("checked", room, inputs)


@pytest.mark.slow
def test_a_file_that_led_out_of_the_buffers(shared_data, tmp_path):
    """Its pulse has a foot of 50 ns: halves of a wide echo were tried before the buffer, and the heap was broken."""
    source = shared_data / "waveform" / "geolas_example2.pls"
    if not source.exists():
        pytest.skip("no geolas_example2.pls")
    ended = process("decompose", source, tmp_path / "out.laz")
    assert ended.returncode == 0 and "taken apart: 1,640" in ended.stderr, ended.stderr
    assert len(laspy.read(tmp_path / "out.laz")) > 10_000
