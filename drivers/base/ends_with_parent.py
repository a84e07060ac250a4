"""Importing this module makes the process die with its parent; fork servers notice their parent's end too late."""

import ctypes
import os
import signal
from contextlib import suppress

PR_SET_PDEATHSIG = 1  # <linux/prctl.h>; forked children do not inherit it

with suppress(OSError, AttributeError):  # not on Linux
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
if os.getppid() == 1:  # the parent has ended already
    os._exit(1)
