"""Worker process, which does the work of another process until that closes their connection.

Use: ``python -P -m drivers.run.worker FOLDER MODULE...``, with the connection as standard input. FOLDER is that of
temporary files. The modules are loaded before the first work. The answer to a function with its argument is True and
the result, or False and the error.
"""

import sys
import tempfile
import traceback
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection


def main() -> None:
    """Work."""
    tempfile.tempdir = sys.argv[1]  # else it would be tried with a file, which a kill would leave there
    for module in sys.argv[2:]:
        import_module(module)
    pipe = Connection(sys.stdin.fileno())
    with suppress(EOFError):
        while True:
            work, item = pipe.recv()
            try:
                answer = True, work(item)
            except Exception as error:
                error.add_note(traceback.format_exc())  # which is lost on the way
                answer = False, error
            pipe.send(answer)


if __name__ == "__main__":
    main()
