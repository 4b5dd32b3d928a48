#!/bin/bash
# Formats every C++ file; with --check only says which are not formatted, and fails.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
arguments=(-i)
[[ "${1:-}" == --check ]] && arguments=(--dry-run --Werror)
find include src test -name '*.h' -o -name '*.cc' | LC_ALL=C sort |
  xargs clang-format --style=file "${arguments[@]}"
