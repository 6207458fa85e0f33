"""What the allocator of a job's child process does, in a process of its own."""

import subprocess
import sys

MEASURE = """
import resource, sys
import numpy as np
from freerein.jobs.allocator import keep_freed_memory

if sys.argv[1] == "kept":
    keep_freed_memory()
for repeat in range(4):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    np.ones(16_000_000)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


RETURN = """
import resource
import numpy as np
from freerein.jobs.allocator import keep_freed_memory

def resident():
    with open("/proc/self/statm") as statm:
        return int(statm.read().split()[1]) * resource.getpagesize()

keep_freed_memory(kept_s=0.1)
freed = np.ones(50_000_000)
before = resident()
del freed
while resident() > before - 300_000_000:
    pass
"""


def new_pages(allocator: str) -> int:
    return int(subprocess.run([sys.executable, "-c", MEASURE, allocator], capture_output=True, check=True).stdout)


def test_an_array_of_128_mb_that_was_freed_is_given_out_again():
    assert new_pages("kept") * 50 < new_pages("glibc")


def test_what_was_freed_long_ago_is_returned_to_the_kernel():
    subprocess.run([sys.executable, "-c", RETURN], check=True, timeout=60)
