#!/bin/bash
# wheels.sh [BPY_VERSION ...] : the tests marked bpy under other releases of Blender's Python module (default: the two
# LTS ones), each in a virtual environment that is thrown away. Blender 4.5 needs Python 3.11, 5.2 needs 3.13; a release
# whose Python is not installed is skipped with that reason. Exit status 1 if any test failed.
set -uo pipefail
cd "$(dirname "$0")/../.."
[ $# = 0 ] && set -- 4.5.15 5.2.3

find_python() { # find_python 3.13 : its path, from PATH or pyenv; empty where there is none
  local candidate
  for candidate in "$(command -v "python$1" || true)" "${PYENV_ROOT:-$HOME/.pyenv}/versions/$1".*/bin/python; do
    # A name on PATH may be a shim that does not run, so each candidate is asked.
    "$candidate" -c "import sys; sys.exit(sys.version_info[:2] != (${1/./, }))" 2>/dev/null && echo "$candidate" && return
  done
}

requirements() { # the project's own, with another bpy
  "$1" -c 'import sys, tomllib
p = tomllib.load(open("pyproject.toml", "rb"))["project"]
print(f"bpy=={sys.argv[1]}", "pytest", *(d for d in p["dependencies"] if not d.startswith("bpy")), sep="\n")' "$2"
}

summary=() failed=0
for version in "$@"; do
  case $version in 4.*|5.0.*) wanted=3.11 ;; *) wanted=3.13 ;; esac
  python=$(find_python $wanted)
  if [ -z "$python" ]; then summary+=("bpy $version: skipped, Python $wanted is not installed"); continue; fi
  folder=$(mktemp -d)
  if "$python" -m venv "$folder" && requirements "$python" "$version" > "$folder/requirements.txt" &&
    "$folder/bin/python" -m pip install -qq --disable-pip-version-check -r "$folder/requirements.txt"; then
    # Left without Blender's own clean-up: in bpy 4.5 that waits for ever after some of the renders.
    "$folder/bin/python" -c 'import os, sys, pytest
code = pytest.main(sys.argv[1:])
sys.stdout.flush()
os._exit(code)' -m "bpy and not slow" -p no:cacheprovider | tee "$folder/log"
    [ "${PIPESTATUS[0]}" = 0 ] || failed=1
    summary+=("bpy $version, Python $wanted: $(grep -aE "[0-9]+ (passed|failed|error)" "$folder/log" | tail -n 1)")
  else
    summary+=("bpy $version, Python $wanted: could not be installed"); failed=1
  fi
  rm -rf "$folder"
done
printf '%s\n' "${summary[@]}"
exit $failed
