"""What all tests share."""

import os
from pathlib import Path

from tests.figures import figures  # noqa: F401

# FFCx gives up where another process compiles the same form for more than 10 s: the processes of
# pytest-xdist compile into a folder of their own each. Set before anything imports DOLFINx.
if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    caches = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    os.environ["XDG_CACHE_HOME"] = str(caches / "femxdem-tests" / worker)
