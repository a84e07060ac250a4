"""Kills the process that imports it when its parent ends: for fork servers, which notice that only between forks."""

import ctypes
import os
import signal
from contextlib import suppress

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>; forked children do not inherit it

with suppress(OSError, AttributeError):  # not on Linux
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
if os.getppid() == 1:  # it has ended already
    os._exit(1)
