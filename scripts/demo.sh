#!/bin/bash
# Installs what is missing, builds, simulates a recording, calibrates it, and prints the result
# against the known truth.
set -euo pipefail
# shellcheck source=scripts/common.sh
source "$(dirname "${BASH_SOURCE[0]}")/common.sh"

install_packages "${build_packages[@]}" "${run_packages[@]}"
build_workspace -DCATKIN_ENABLE_TESTING=OFF
use_workspace

demo="$repository/build/demo"
mkdir -p "$demo"
if [[ ! -f "$demo/recording/truth_image_times.txt" ]]; then
  echo "Simulating a drive of 10 s"
  rosrun scenecalib simulate --output "$demo/recording" --seed 1 --duration 10
fi
roslaunch scenecalib calibrate_bag.launch bag:="$demo/recording/recording.bag" \
  rig:="$demo/recording/rig_initial.yaml" truth:="$demo/recording/truth.yaml" output:="$demo/result"
if [[ ! -f "$demo/result/calibration.yaml" ]]; then
  echo "The calibration failed: see above." >&2
  exit 1
fi
echo
cat "$demo/result/report.txt"
echo "Result: $demo/result (calibration.yaml, overlays/)"
