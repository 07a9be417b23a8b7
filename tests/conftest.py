"""What holds before any test module is read, and round every test."""

import os

# Before torch starts its threads, and for the processes that tests start: on a busy machine threads that wait for each
# other take many times as long, and what is tested sets its own number where that counts.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # and such threads sleep, not spin, where a fit takes two

import pytest
import torch


@pytest.fixture(autouse=True)
def _threads_are_given_back():
    """What a test runs sets the threads of its process, which here is that of all tests after it."""
    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)
