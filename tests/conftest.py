"""What holds before any test module is read."""

import os

# Before torch starts its threads, and for the processes that tests start: on a busy machine threads that wait for each
# other take many times as long, and what is tested sets its own number where that counts.
os.environ.setdefault("OMP_NUM_THREADS", "1")
