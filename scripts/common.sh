# Shared by demo.sh and test.sh: Debian packages and the workspace. Sourced, not run.

repository="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
workspace="$repository/build/ws"

build_packages=(
  build-essential cmake catkin python3-catkin-pkg python3-empy
  libeigen3-dev libceres-dev libopencv-dev libembree-dev libtbb-dev libyaml-cpp-dev
  libcli11-dev libbz2-dev
  ros-message-generation ros-message-runtime libroscpp-dev librosbag-storage-dev libroslz4-dev
  libcv-bridge-dev libnodelet-dev libnodeletlib-dev libdiagnostic-updater-dev libtf2-ros-dev
  libtf2-msgs-dev libdiagnostic-msgs-dev libgeometry-msgs-dev libnav-msgs-dev libsensor-msgs-dev
  libstd-msgs-dev libstd-srvs-dev libvisualization-msgs-dev
  ros-actionlib-msgs ros-diagnostic-msgs ros-geometry-msgs ros-nav-msgs ros-sensor-msgs ros-std-msgs
  ros-std-srvs ros-tf2-msgs ros-visualization-msgs
)
run_packages=(
  python3-roslaunch python3-rosservice python3-rosbag python3-rosmaster rosout rosbash python3-std-srvs
  python3-std-msgs python3-geometry-msgs
)
test_packages=(
  libgtest-dev librostest-dev python3-rostest python3-rospy python3-tf2-ros python3-yaml
  python3-numpy python3-sensor-msgs python3-visualization-msgs python3-diagnostic-msgs
  libnodeletlib-tools tf2-tools python3-roslz4 clang-format catkin-lint
)

# Installs those of the named packages that are missing, and says which.
install_packages() {
  local missing=() package
  for package in "$@"; do
    if [[ "$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null)" != installed ]]; then
      missing+=("$package")
    fi
  done
  if ((${#missing[@]} == 0)); then
    echo "Every Debian package that is needed is installed."
    return
  fi
  echo "Installing Debian packages: ${missing[*]}"
  local as_root=()
  ((EUID == 0)) || as_root=(sudo)
  "${as_root[@]}" apt-get update -q
  DEBIAN_FRONTEND=noninteractive "${as_root[@]}" apt-get install -q -y --no-install-recommends \
    "${missing[@]}"
}

# Puts the package into the workspace: links to what the repository holds except build/, which holds
# the workspace. A link to the whole would contain itself, and ROS walks packages through links.
link_sources() {
  local package="$workspace/src/scenecalib" entry
  rm -rf "$package"
  mkdir -p "$package"
  for entry in "$repository"/*; do
    [[ "$(basename "$entry")" == build ]] || ln -s "$entry" "$package/"
  done
}

# Makes the workspace and builds there; arguments go to catkin_make.
build_workspace() {
  link_sources
  (
    cd "$workspace"
    # The system's Python is the one that Debian's ROS needs, whatever else is on the PATH.
    catkin_make -j"$(jobs_that_fit)" -DPYTHON_EXECUTABLE=/usr/bin/python3 \
      -DPython3_EXECUTABLE=/usr/bin/python3 "$@"
  )
}

# One compiler per core, as long as each has about 2 GiB of memory.
jobs_that_fit() {
  local cores gibibytes
  cores="$(nproc)"
  gibibytes="$(awk '/MemTotal/ {print int($2 / 1048576)}' /proc/meminfo)"
  local by_memory=$((gibibytes / 2 > 0 ? gibibytes / 2 : 1))
  echo $((cores < by_memory ? cores : by_memory))
}

use_workspace() {
  set +u
  # shellcheck disable=SC1091
  source "$workspace/devel/setup.bash"
  set -u
}
