"""Runs a command in a session of its own, and ends the whole session with it or with the process that asked for it.

Use: ``python -I -S launcher.py SOCKET COMMAND...``. A process that is killed cannot end what it has started, so this
small program does. SOCKET is the number of a socket to the process that asked: its end is the request to end. The
answer has the exit code, the CPU time in s and the peak memory in bytes. They are measured here, since the peak of a
process counts the memory of the one that starts it.
"""

import _thread
import os
import signal
import sys
import time

PAUSE_S = 0.005


def kill_session() -> bool:
    """Kill the other processes of this session, in any of its groups; False if none is left."""
    found, here = False, os.getpid()
    for number in [int(entry.name) for entry in os.scandir("/proc") if entry.name.isdigit()]:
        try:
            if number != here and os.getsid(number) == here:
                with open(f"/proc/{number}/stat", errors="replace") as file:
                    ended = file.read().rpartition(")")[2].split()[0] in "ZX"  # and waits for its parent
                if not ended:
                    os.kill(number, signal.SIGKILL)
                    found = True
        except OSError:  # it has just ended, or is another user's
            continue
    return found


def end_session() -> None:
    """Kill the other processes of this session and wait until they have ended: they may be inside a system call."""
    while kill_session():
        time.sleep(PAUSE_S)


def follow(request: int) -> None:
    """Wait for the request to end."""
    os.read(request, 1)
    end_session()


def main() -> None:
    """Run the command."""
    request, command = int(sys.argv[1]), sys.argv[2:]
    os.set_inheritable(request, False)
    try:
        child = os.posix_spawnp(command[0], command, os.environ, setsigdef=[signal.SIGPIPE, signal.SIGXFSZ])
    except OSError as error:
        sys.exit(f"cannot start: {error}")
    _thread.start_new_thread(follow, (request,))
    _, status, usage = os.wait4(child, 0)
    end_session()
    report = f"{os.waitstatus_to_exitcode(status)} {usage.ru_utime + usage.ru_stime} {usage.ru_maxrss * 1024}"
    try:
        os.write(request, report.encode())
    except OSError:  # nobody is left who asks
        pass
    os._exit(0)


if __name__ == "__main__":
    main()
