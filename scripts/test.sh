#!/bin/bash
# Installs what is missing, builds, runs every test (gtest and rostest), the format check and
# catkin_lint. The last line is "N passed, N failed".
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

install_packages "${build_packages[@]}" "${run_packages[@]}" "${test_packages[@]}"
build_workspace -DCATKIN_ENABLE_TESTING=ON
build_workspace -DCATKIN_ENABLE_TESTING=ON tests
use_workspace

results="$workspace/build/test_results"
rm -rf "$results"
# One test at a time: rostests share the machine's cores with nothing.
(cd "$workspace" && catkin_make -j1 run_tests) || echo "some tests failed, see below"
"$repository/scripts/summarise_tests.py" "$results" \
  "clang-format=$repository/scripts/format.sh --check" \
  "catkin_lint=catkin_lint --strict -W1 $repository"
