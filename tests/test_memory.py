"""Memory: what a process frees it uses again, and gives it back where it holds much."""

import os
import subprocess
import sys

import pytest

from fwclass import cost, memory

AGAIN = """
import os, resource, numpy as np
from fwclass import memory
KEEP
def faults(): return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def used():
    array = np.zeros(2_000_000) + 1.0  # 16 MB, twice
    return array[0]
used()
before = faults()
for _ in range(20): used()
print(faults() - before)
"""


def faults(keep: str, **environment: str) -> int:
    plain = {n: v for n, v in os.environ.items() if not n.startswith("MALLOC_")}
    plain |= {"MALLOC_TRIM_THRESHOLD_": "65536", **environment}  # as Dask's nannies have it
    words = [sys.executable, "-c", AGAIN.replace("KEEP", keep)]
    return int(subprocess.run(words, env=plain, capture_output=True, text=True, check=True).stdout)


needs_glibc = pytest.mark.skipif(memory._library() is None, reason="no GNU C library")


@needs_glibc
def test_arrays_made_anew_fault_no_page_in_again():
    assert 20 * faults("memory.keep_freed()") < faults("")


@needs_glibc
def test_what_the_user_sets_holds():
    assert faults("memory.keep_freed()", MALLOC_MMAP_THRESHOLD_="131072") > 4 * faults("memory.keep_freed()")


@needs_glibc
def test_a_large_process_gives_back_and_a_small_one_keeps():
    text = (
        "import numpy as np\nfrom fwclass import memory\nmemory.keep_freed()\n"
        "def hold():\n    return len([np.ones(1 << 20) for _ in range(50)])\n"  # 400 MiB
        "hold()\nbefore = memory.resident_bytes()\nmemory.give_back(None)\nsmall = memory.resident_bytes()\n"
        "memory.give_back(512 << 20)\nprint(before, small, memory.resident_bytes())\n"
    )
    plain = {n: v for n, v in os.environ.items() if not n.startswith("MALLOC_")}
    done = subprocess.run([sys.executable, "-c", text], env=plain, capture_output=True, text=True, check=True)
    before, small, after = map(int, done.stdout.split())
    assert before > 400 << 20 and abs(small - before) < 1 << 20  # a page of its own may come in between
    assert after < before - (350 << 20)


@pytest.mark.parametrize(
    ("environment", "pool"), [({}, "system"), ({"ARROW_DEFAULT_MEMORY_POOL": "mimalloc"}, "mimalloc")]
)
def test_a_part_has_arrow_free_its_memory_for_all(environment, pool):
    text = (
        "import pyarrow as pa\nfrom fwclass.run.part import settle_process\n"
        "settle_process()\nprint(pa.default_memory_pool().backend_name)"
    )
    plain = {n: v for n, v in os.environ.items() if n != "ARROW_DEFAULT_MEMORY_POOL"} | environment
    done = subprocess.run([sys.executable, "-c", text], env=plain, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == pool


def test_costs_count_once_and_for_each_kind():
    before = cost.cost_so_far()
    with cost.counted("writing"), cost.counted("reading"):
        sum(range(200_000))
    took = cost.since(before)
    assert took["writing"] > 0 and took["reading"] == 0
    assert took["user"] + took["system"] > 0
