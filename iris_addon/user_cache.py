"""The user's cache folder, by the convention of each system."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def user_cache() -> Path:
    """Where files are kept that save time and that nobody misses."""
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "iris" / "cache"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "iris"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "iris"
