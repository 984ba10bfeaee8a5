# Helpers that every target of the project is made with, so that warnings, includes and exports are stated once.

# soft_volume_library(NAME [TYPE] [SOURCES...]): a library of our own code, with our warnings and include folder; TYPE
# as add_library() takes it.
function(soft_volume_library name)
  add_library(${name} ${ARGN})
  target_include_directories(${name} PUBLIC $<BUILD_INTERFACE:${PROJECT_SOURCE_DIR}/include>
                                            $<INSTALL_INTERFACE:include>)
  target_compile_features(${name} PUBLIC cxx_std_17)
  target_compile_options(${name} PRIVATE -Wall -Wextra -Werror)
endfunction()

# soft_volume_program(NAME SOURCES... LINK LIBRARIES...): a program next to the other programs.
function(soft_volume_program name)
  cmake_parse_arguments(ARG "" "" "LINK" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  target_compile_options(${name} PRIVATE -Wall -Wextra -Werror)
  target_link_libraries(${name} PRIVATE ${ARG_LINK})
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${SOFT_VOLUME_BIN_DIR})
endfunction()

# soft_volume_install_core(NAME DEPENDENCIES...): installs a ROS-free library with an exported target of its own, so
# that find_package(NAME) works without any ROS package.
function(soft_volume_install_core name)
  install(TARGETS ${name} EXPORT ${name}Targets
          ARCHIVE DESTINATION ${CMAKE_INSTALL_LIBDIR} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
  install(EXPORT ${name}Targets NAMESPACE soft_volume:: DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/${name})
  set(config ${CMAKE_CURRENT_BINARY_DIR}/${name}Config.cmake)
  file(WRITE ${config}.in "include(CMakeFindDependencyMacro)\n")
  foreach(dependency ${ARGN})
    file(APPEND ${config}.in "find_dependency(${dependency})\n")
  endforeach()
  file(APPEND ${config}.in "include(\${CMAKE_CURRENT_LIST_DIR}/${name}Targets.cmake)\n")
  configure_file(${config}.in ${config} COPYONLY)
  write_basic_package_version_file(${config}Version.cmake COMPATIBILITY SameMinorVersion)
  string(REPLACE "Config.cmake" "ConfigVersion.cmake" version ${config})
  file(RENAME ${config}Version.cmake ${version})
  install(FILES ${config} ${version} DESTINATION ${CMAKE_INSTALL_LIBDIR}/cmake/${name})
endfunction()

# soft_volume_test(NAME SOURCES... LINK LIBRARIES...): a GoogleTest program run by ctest. catkin_add_gtest is not used
# because it breaks on a space in the path.
function(soft_volume_test name)
  cmake_parse_arguments(ARG "" "" "LINK" ${ARGN})
  add_executable(${name} ${ARG_UNPARSED_ARGUMENTS})
  target_compile_options(${name} PRIVATE -Wall -Wextra -Werror)
  target_include_directories(${name} PRIVATE ${PROJECT_SOURCE_DIR}/test)
  target_compile_definitions(${name} PRIVATE SOFT_VOLUME_SOURCE_DIR="${PROJECT_SOURCE_DIR}"
                                             SOFT_VOLUME_BIN_DIR="${SOFT_VOLUME_BIN_DIR}")
  target_link_libraries(${name} PRIVATE ${ARG_LINK} GTest::gtest GTest::gtest_main)
  set_target_properties(${name} PROPERTIES RUNTIME_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/tests)
  add_test(NAME ${name} COMMAND ${name})
  set(timeout_s 300)
  if(SOFT_VOLUME_SANITIZE)
    set(timeout_s 1200)
  endif()
  set_tests_properties(${name} PROPERTIES TIMEOUT ${timeout_s})
endfunction()

# soft_volume_leave_out_instrumented(TEST CASES): cases of a test that a sanitizer's build takes minutes for, or cannot
# run; what they call is called by other cases, too. After the test's other properties.
function(soft_volume_leave_out_instrumented name cases)
  if(SOFT_VOLUME_SANITIZE)
    set_property(TEST ${name} APPEND PROPERTY ENVIRONMENT "GTEST_FILTER=-${cases}")
  endif()
endfunction()
