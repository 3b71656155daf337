"""Runs a program and writes its exit code, processor seconds and peak memory in bytes as JSON: usage.py FILE PROGRAM ARGUMENT ...

A process of its own: Linux counts the memory of the process that starts a program into the peak of that program, and this one needs little.
"""

import json
import os
import sys

if __name__ == "__main__":
    _, status, usage = os.wait4(os.posix_spawnp(sys.argv[2], sys.argv[2:], os.environ), 0)
    with open(sys.argv[1], "w") as file:
        code = os.waitstatus_to_exitcode(status)
        # Linux counts kibibytes.
        json.dump({"code": code, "processor": usage.ru_utime + usage.ru_stime, "memory": usage.ru_maxrss * 1024}, file)
