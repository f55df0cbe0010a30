"""Become another program, without privileges to look into processes: ``python -I -S unprivileged.py PROGRAM WORD …``.

A script that imports nothing of prbench, so that it starts at once, whatever the environment.
"""

import ctypes
import os
import signal
import sys

_PR_CAPBSET_DROP = 24
_PR_SET_NO_NEW_PRIVS = 38
# CAP_SYS_PTRACE, CAP_SYS_ADMIN and CAP_PERFMON: with any of them root reads hidden processes, too.
_CAPABILITIES = (19, 21, 38)

if __name__ == "__main__":
    library = ctypes.CDLL(None)
    library.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0)  # sudo gives none back
    for capability in _CAPABILITIES:
        library.prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)  # refused to everybody who has none
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # Python ignores it, and a program would inherit that
    os.execvp(sys.argv[1], sys.argv[1:])
