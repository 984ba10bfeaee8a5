# The ROS part: messages, services and the catkin package. Included from the top level before any target.
find_package(catkin REQUIRED COMPONENTS
  diagnostic_updater dynamic_reconfigure geometry_msgs image_transport message_generation nodelet pluginlib
  rosbag_storage roscpp rosgraph_msgs roslz4 sensor_msgs std_msgs std_srvs topic_tools)

add_message_files(DIRECTORY msg FILES
  GridPatch.msg GridState.msg GridTopology.msg HeldForce.msg HeldGrip.msg IncisionState.msg JournalEntry.msg
  PartRemoval.msg RecorderEvent.msg RecorderStatus.msg RecordingInfo.msg RenderStats.msg Scene.msg
  SimulationCheckpoint.msg SimulationControl.msg SimulationJournal.msg SimulationStats.msg StrokeState.msg ToolCut.msg
  ToolForce.msg ToolGrip.msg ToolProgress.msg ToolState.msg Volume.msg)
add_service_files(DIRECTORY srv FILES
  RemovePart.srv RestoreCheckpoint.srv SaveCheckpoint.srv SetIntegrator.srv StepSimulation.srv)
generate_messages(DEPENDENCIES geometry_msgs std_msgs)
generate_dynamic_reconfigure_options(cfg/Renderer.cfg)

catkin_package(
  INCLUDE_DIRS include
  LIBRARIES soft_volume_core soft_volume_render soft_volume_messages soft_volume_replay_core soft_volume_ros
  CATKIN_DEPENDS diagnostic_updater dynamic_reconfigure geometry_msgs image_transport message_runtime nodelet pluginlib
                 rosbag_storage roscpp rosgraph_msgs roslz4 sensor_msgs std_msgs std_srvs topic_tools
  DEPENDS EIGEN3
  CFG_EXTRAS soft_volume_bag_test.cmake)

set(SOFT_VOLUME_BIN_DIR ${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION})
set(SOFT_VOLUME_BAG_TEST_PROGRAMS ${SOFT_VOLUME_BIN_DIR})
include(${CMAKE_CURRENT_LIST_DIR}/soft_volume_bag_test.cmake)

# soft_volume_ros_library(NAME): a library of ours that uses ROS.
function(soft_volume_ros_library name)
  soft_volume_library(${name})
  target_include_directories(${name} SYSTEM PUBLIC ${catkin_INCLUDE_DIRS})
  target_link_libraries(${name} PUBLIC ${catkin_LIBRARIES})
  add_dependencies(${name} ${PROJECT_NAME}_generate_messages_cpp ${PROJECT_NAME}_gencfg)
  install(TARGETS ${name} ARCHIVE DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION}
                          LIBRARY DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION})
endfunction()

install(DIRECTORY launch config DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
install(PROGRAMS scripts/sample_data DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
