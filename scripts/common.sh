# shellcheck shell=bash
# Sourced by the scripts of this folder (bash): paths, messages, building, and a ROS graph of one's own.
# Every name that it defines starts with sv_.

sv_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
sv_build=$sv_root/build
sv_jobs=$(nproc)
# The system's Python first: with another one on the PATH, catkin would pick that, which has no ROS.
export PATH=/usr/bin:$PATH
export SOFT_VOLUME_CACHE=${SOFT_VOLUME_CACHE:-${XDG_CACHE_HOME:-$HOME/.cache}/soft_volume}

sv_say() { printf '%s: %s\n' "$(basename "$0")" "$*"; }

sv_fail() {
  printf '%s: error: %s\n' "$(basename "$0")" "$*" >&2
  exit 1
}

sv_stage() { printf '\n== %s (%s)\n' "$*" "$(date +%H:%M:%S)"; }

# ---------------------------------------------------------------------------------------------------------- building

# Prints one line for every tenth of a build, from make's percentages.
sv_build_progress() {
  local line next=0
  while IFS= read -r line; do
    if [[ $line =~ ^\[\ *([0-9]+)%\] ]] && [ "${BASH_REMATCH[1]}" -ge "$next" ]; then
      printf '  %3d %%\n' "${BASH_REMATCH[1]}"
      next=$((BASH_REMATCH[1] / 10 * 10 + 10))
    fi
  done
}

# sv_cmake_build DIR [OPTIONS...] [-- BUILD OPTIONS...]: configures and builds DIR with CMake. A second caller waits for
# the first one, so that two runs side by side can share the folder. Everything goes to DIR/build.log; what failed is
# shown.
sv_cmake_build() {
  local dir=$1 options=()
  shift
  while [ $# -gt 0 ] && [ "$1" != -- ]; do
    options+=("$1")
    shift
  done
  [ $# -eq 0 ] || shift
  mkdir -p "$dir"
  (
    flock -n 9 || { sv_say "another build of $dir runs; waiting"; flock 9; }
    local log=$dir/build.log
    if ! cmake -S "$sv_root" -B "$dir" -DPYTHON_EXECUTABLE=/usr/bin/python3 -DPython3_EXECUTABLE=/usr/bin/python3 \
      "${options[@]}" >"$log" 2>&1 9>&-; then
      tail -n 40 "$log" >&2
      sv_fail "configuring failed (above; all of it is in $log)"
    fi
    if ! cmake --build "$dir" --parallel "$sv_jobs" "$@" 2>&1 9>&- | tee -a "$log" | sv_build_progress; then
      grep -n -E -A 5 'error:|Error [0-9]|undefined reference|No rule|Killed' "$log" | head -n 60 >&2
      sv_fail "building failed (above; all of it is in $log)"
    fi
  ) 9>"$dir/.lock"
}

# The build that README.md speaks of: everything, optimised.
sv_build_release() { sv_cmake_build "$sv_build" -DCMAKE_BUILD_TYPE=Release -DSOFT_VOLUME_ROS=ON; }

sv_sample_data() { "$sv_root/scripts/sample_data" --cache "$SOFT_VOLUME_CACHE"; }

# --------------------------------------------------------------------------------------------------------- processes

# Every process that a script starts inherits this mark; so the script finds and ends all of them and no others.
sv_mark=soft_volume_$$_$(date +%s%N)
export SOFT_VOLUME_RUN=$sv_mark

sv_marked_processes() {
  local environ pid
  for environ in /proc/[0-9]*/environ; do
    pid=${environ#/proc/}
    pid=${pid%/environ}
    if [ "$pid" != "$$" ] && [ "$pid" != "$BASHPID" ] && grep -qzxF "SOFT_VOLUME_RUN=$sv_mark" "$environ" 2>/dev/null; then
      printf '%s\n' "$pid"
    fi
  done
}

# sv_start LOG COMMAND...: starts a process in a session of its own (a Ctrl-C reaches the script alone, which then ends
# things in order) that ends with the script. Sets sv_pid.
sv_start() {
  local log=$1
  shift
  setsid setpriv --pdeathsig TERM -- "$@" >"$log" 2>&1 </dev/null 7>&- 8>&- 9>&- &
  sv_pid=$!
}

# sv_run COMMAND...: runs a command or function to its end, but lets a signal to the script act at once: bash handles
# signals only between foreground commands, and while it waits.
sv_run() {
  "$@" 7>&- 8>&- &
  wait $!
}

sv_alive() { kill -0 "$1" 2>/dev/null; }

# sv_wait_end PID SECONDS: true when the process ended in time.
sv_wait_end() {
  local deadline=$((SECONDS + $2))
  while sv_alive "$1"; do
    [ "$SECONDS" -lt "$deadline" ] || return 1
    sleep 0.1
  done
}

# sv_stop PID [SECONDS]: asks a process that sv_start started to end, and waits.
sv_stop() {
  sv_alive "$1" || return 0
  kill -INT "$1" 2>/dev/null || true
  sv_wait_end "$1" "${2:-20}"
}

# Ends everything that carries the mark: first kindly, in the end by force.
sv_end_processes() {
  local signal pids deadline
  for signal in TERM KILL; do
    deadline=$((SECONDS + 10))
    pids=$(sv_marked_processes)
    [ -n "$pids" ] || return 0
    # shellcheck disable=SC2086
    kill -"$signal" $pids 2>/dev/null || true
    while [ -n "$(sv_marked_processes)" ] && [ "$SECONDS" -lt "$deadline" ]; do sleep 0.2; done
  done
}

# --------------------------------------------------------------------------------------------------------------- ROS

# sv_ros_environment: the build's environment with a temporary ROS_HOME (sv_temp, without a space, because rostest and
# roslaunch do not quote) and a master's port of one's own.
sv_ros_environment() {
  sv_temp=$(mktemp -d /tmp/soft_volume.XXXXXXXX)
  set +u
  # shellcheck disable=SC1091
  source "$sv_build/devel/setup.bash"
  set -u
  export PATH=/usr/bin:$PATH ROS_HOME=$sv_temp/ros ROS_LOG_DIR=$sv_temp/ros/log ROS_IP=127.0.0.1
  unset ROS_HOSTNAME ROS_TEST_RESULTS_DIR
  mkdir -p "$ROS_LOG_DIR"
  sv_new_master_uri
}

sv_new_master_uri() {
  sv_port=$(/usr/bin/python3 -c 'import socket; s = socket.socket(); s.bind(("127.0.0.1", 0)); print(s.getsockname()[1])')
  export ROS_MASTER_URI=http://127.0.0.1:$sv_port
}

# sv_roscore: starts a master. Another program may take the free port before the master does, hence the tries.
sv_roscore() {
  local attempt deadline
  for attempt in 1 2 3; do
    sv_start "$sv_temp/roscore.log" roscore -p "$sv_port"
    deadline=$((SECONDS + 30))
    while sv_alive "$sv_pid" && [ "$SECONDS" -lt "$deadline" ]; do
      rosparam get /rosdistro >/dev/null 2>&1 && sv_alive "$sv_pid" && return 0
      sleep 0.2
    done
    sv_new_master_uri
  done
  cat "$sv_temp/roscore.log" >&2
  sv_fail "the ROS master does not start (above)"
}

# sv_on_exit: from here on, ends every process and removes the temporary folder however the script ends.
sv_on_exit() {
  trap sv_cleanup EXIT
  trap 'exit 129' HUP
  trap 'exit 130' INT
  trap 'exit 143' TERM
}

sv_cleanup() {
  local code=$?
  trap '' HUP INT TERM
  disown -a  # no notices about processes that are ended now
  sv_end_processes
  [ -z "${sv_temp:-}" ] || rm -rf "$sv_temp"
  exit "$code"
}
