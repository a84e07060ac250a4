"""Runs a command and ends it, with all that it has started, when the process that asked for it does so or dies.

Use: ``python -I -S launcher.py SOCKET COMMAND...``. A process that is killed cannot end what it has started, so this
small program does. SOCKET is the number of a socket to the process that asked: its end is the request to end. The
answer has the exit code, the CPU time in s and the peak memory in bytes. They are measured here, since the peak of a
process counts the memory of the one that starts it. Linux only.
"""

import _thread
import ctypes
import os
import signal
import sys

PR_SET_CHILD_SUBREAPER = 36  # of <sys/prctl.h>


def follow(request: int, command: int) -> None:
    """Wait for the request to end."""
    os.read(request, 1)
    try:
        os.kill(command, signal.SIGKILL)
    except ProcessLookupError:
        pass
    except PermissionError:  # of another user, as with sudo
        os._exit(1)


def end_orphans() -> None:
    """Kill the children of this process, also in sessions of their own, until there are none."""
    while True:
        try:
            for task in os.scandir("/proc/self/task"):
                with open(f"{task.path}/children") as children:
                    for child in children.read().split():
                        os.kill(int(child), signal.SIGKILL)
            os.wait()
        except OSError:  # there are none, or they are of another user
            break


def main() -> None:
    """Run the command."""
    request, command = int(sys.argv[1]), sys.argv[2:]
    os.set_inheritable(request, False)  # else nobody would see that this process was killed
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)  # processes whose parents die become its children
    try:
        child = os.posix_spawnp(command[0], command, os.environ, setsigdef=[signal.SIGPIPE, signal.SIGXFSZ])
    except OSError as error:
        sys.exit(f"cannot start: {error}")
    _thread.start_new_thread(follow, (request, child))
    ended = 0
    while ended != child:
        ended, status, usage = os.wait3(0)
    end_orphans()
    report = f"{os.waitstatus_to_exitcode(status)} {usage.ru_utime + usage.ru_stime} {usage.ru_maxrss * 1024}"
    try:
        os.write(request, report.encode())
    except BrokenPipeError:  # the process that asked has died
        pass


if __name__ == "__main__":
    main()
