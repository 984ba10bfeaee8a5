# Bags as regression tests. Comes with find_package(soft_volume) or as a component of catkin, from devel and install
# space; doc/bags.md explains it.
#
# soft_volume_add_bag_test(NAME name BAG file
#                          [TOLERANCE limit=value... | limits.yaml] [AGAINST other.bag] [RESIMULATE [key=value...]]
#                          [THREADS n] [TIMEOUT seconds])
#
# Adds a test for ctest, and for `run_tests` where catkin's testing is on. Paths are relative to the current source
# folder and may hold spaces. What the test asks:
#   by default   the bag's inputs, applied again, give what was recorded (soft_volume_replay --check)
#   AGAINST      two recordings are the same
#   RESIMULATE   the recorded motion of the device gives what was recorded, through tool and simulation, with other
#                settings where given; needs a tolerance
# Bit for bit, or within TOLERANCE. The test leaves NAME.json with all figures in the current binary folder.

# Where the programs are. The project itself sets it; else they lie in the workspace that this package was found in.
if(NOT SOFT_VOLUME_BAG_TEST_PROGRAMS)
  get_filename_component(SOFT_VOLUME_BAG_TEST_PROGRAMS "${soft_volume_DIR}/../../../lib/soft_volume" ABSOLUTE)
endif()

# A function keeps the policies that it was defined with: packages may ask for a CMake that is older than IN_LIST.
cmake_policy(PUSH)
cmake_policy(VERSION 3.16)

function(soft_volume_add_bag_test)
  cmake_parse_arguments(ARG "" "NAME;BAG;AGAINST;THREADS;TIMEOUT" "TOLERANCE;RESIMULATE" ${ARGN})
  if(ARG_UNPARSED_ARGUMENTS)
    message(FATAL_ERROR "soft_volume_add_bag_test: unknown arguments: ${ARG_UNPARSED_ARGUMENTS}")
  endif()
  foreach(needed NAME BAG)
    if(NOT ARG_${needed})
      message(FATAL_ERROR "soft_volume_add_bag_test: ${needed} is missing")
    endif()
  endforeach()
  set(resimulate FALSE)
  if(DEFINED ARG_RESIMULATE OR "RESIMULATE" IN_LIST ARG_KEYWORDS_MISSING_VALUES)
    set(resimulate TRUE)
  endif()
  if(resimulate AND ARG_AGAINST)
    message(FATAL_ERROR "soft_volume_add_bag_test: ${ARG_NAME}: give either AGAINST or RESIMULATE")
  endif()
  if(resimulate AND NOT ARG_TOLERANCE)
    message(FATAL_ERROR "soft_volume_add_bag_test: ${ARG_NAME}: RESIMULATE needs a TOLERANCE")
  endif()

  get_filename_component(bag "${ARG_BAG}" ABSOLUTE)
  set(arguments "${bag}" --no-progress --json "${CMAKE_CURRENT_BINARY_DIR}/${ARG_NAME}.json")
  if(resimulate)
    string(REPLACE ";" "," changes "${ARG_RESIMULATE}")
    list(APPEND arguments "--resimulate=${changes}" --output "${CMAKE_CURRENT_BINARY_DIR}/${ARG_NAME}.bag")
  elseif(ARG_AGAINST)
    get_filename_component(other "${ARG_AGAINST}" ABSOLUTE)
    list(APPEND arguments --against "${other}")
  else()
    list(APPEND arguments --check)
  endif()
  if(ARG_TOLERANCE)
    string(REPLACE ";" "," tolerance "${ARG_TOLERANCE}")
    if(NOT tolerance MATCHES "=")
      get_filename_component(tolerance "${tolerance}" ABSOLUTE)
    endif()
    list(APPEND arguments --tolerance "${tolerance}")
  endif()
  if(ARG_THREADS)
    list(APPEND arguments --threads ${ARG_THREADS})
  endif()

  set(program "${SOFT_VOLUME_BAG_TEST_PROGRAMS}/bag_test")
  add_test(NAME ${ARG_NAME} COMMAND "${program}" ${arguments})
  if(NOT ARG_TIMEOUT)
    set(ARG_TIMEOUT 600)
  endif()
  set_tests_properties(${ARG_NAME} PROPERTIES TIMEOUT ${ARG_TIMEOUT})

  # catkin's own function does not quote what holds a space.
  if(TARGET run_tests AND catkin_EXTRAS_DIR)
    set(result "${CATKIN_TEST_RESULTS_DIR}/${PROJECT_NAME}/bag-${ARG_NAME}.xml")
    set(command "'${program}'")
    foreach(argument ${arguments} "--gtest_output=xml:${result}")
      string(APPEND command " '${argument}'")
    endforeach()
    add_custom_target(run_tests_${PROJECT_NAME}_bag_${ARG_NAME}
      COMMAND ${CATKIN_ENV} "${PYTHON_EXECUTABLE}" "${catkin_EXTRAS_DIR}/test/run_tests.py" "${result}" "${command}" VERBATIM)
    add_dependencies(run_tests run_tests_${PROJECT_NAME}_bag_${ARG_NAME})
  endif()
endfunction()

cmake_policy(POP)
