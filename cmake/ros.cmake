# The ROS layer: messages, conversions, bag reading, nodes.
# The core libraries must not see ROS, so its include paths belong to scenecalib_ros and not to the
# directory; scripts/ is for a clone, not for an installation.
#catkin_lint: ignore external_directory external_interface_path unused_include_path
#catkin_lint: ignore uninstalled_script
set(SCENECALIB_ROS_PACKAGES cv_bridge diagnostic_msgs diagnostic_updater geometry_msgs nav_msgs nodelet
  rosbag_storage roscpp roslz4 sensor_msgs std_msgs std_srvs tf2_msgs tf2_ros visualization_msgs)
find_package(catkin REQUIRED COMPONENTS ${SCENECALIB_ROS_PACKAGES} message_generation)
find_package(BZip2 REQUIRED)
find_package(Threads REQUIRED)

add_message_files(FILES Calibration.msg CalibrationStatus.msg CameraResult.msg MapSnapshot.msg
  PixelTrack.msg SegmentState.msg SurfelDisc.msg)
add_service_files(FILES BuildMap.srv GetCalibration.srv GetSegment.srv Recalibrate.srv Save.srv)
generate_messages(DEPENDENCIES geometry_msgs sensor_msgs std_msgs)

catkin_package(
  INCLUDE_DIRS include
  LIBRARIES ${SCENECALIB_LIBRARIES} scenecalib_ros scenecalib_nodelets
  CATKIN_DEPENDS ${SCENECALIB_ROS_PACKAGES} message_runtime)

file(GLOB sources CONFIGURE_DEPENDS src/ros/*.cc)
list(SORT sources)
add_library(scenecalib_ros ${sources})
add_dependencies(scenecalib_ros ${PROJECT_NAME}_generate_messages_cpp ${catkin_EXPORTED_TARGETS})
target_include_directories(scenecalib_ros SYSTEM PUBLIC
  ${CATKIN_DEVEL_PREFIX}/include ${catkin_INCLUDE_DIRS} ${BZIP2_INCLUDE_DIR})
target_compile_options(scenecalib_ros PRIVATE -Wall -Wextra -Wpedantic)
target_link_libraries(scenecalib_ros PUBLIC scenecalib_pipeline opencv_imgcodecs ${catkin_LIBRARIES}
  ${BZIP2_LIBRARIES} Threads::Threads)
if(TARGET scenecalib_simulation)
  target_link_libraries(scenecalib_ros PUBLIC scenecalib_simulation)
endif()

# One executable per src/nodes/<name>_main.cc, named <name>.
file(GLOB mains CONFIGURE_DEPENDS src/nodes/*_main.cc)
set(SCENECALIB_EXECUTABLES)
foreach(main IN LISTS mains)
  get_filename_component(name ${main} NAME)
  string(REPLACE "_main.cc" "" name ${name})
  add_executable(scenecalib_${name} ${main})
  set_target_properties(scenecalib_${name} PROPERTIES OUTPUT_NAME ${name})
  target_compile_options(scenecalib_${name} PRIVATE -Wall -Wextra -Wpedantic)
  target_link_libraries(scenecalib_${name} scenecalib_ros)
  list(APPEND SCENECALIB_EXECUTABLES scenecalib_${name})
endforeach()

# The same nodes for a nodelet manager (nodelet_plugins.xml).
add_library(scenecalib_nodelets src/nodes/nodelets.cc)
target_compile_options(scenecalib_nodelets PRIVATE -Wall -Wextra -Wpedantic)
target_link_libraries(scenecalib_nodelets PUBLIC scenecalib_ros)

install(TARGETS ${SCENECALIB_EXECUTABLES} RUNTIME DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
install(TARGETS ${SCENECALIB_LIBRARIES} scenecalib_ros scenecalib_nodelets
  ARCHIVE DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION}
  LIBRARY DESTINATION ${CATKIN_PACKAGE_LIB_DESTINATION}
  RUNTIME DESTINATION ${CATKIN_GLOBAL_BIN_DESTINATION})
install(DIRECTORY include/${PROJECT_NAME}/ DESTINATION ${CATKIN_PACKAGE_INCLUDE_DESTINATION})
install(DIRECTORY launch config rviz DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
install(FILES nodelet_plugins.xml DESTINATION ${CATKIN_PACKAGE_SHARE_DESTINATION})
