# One gtest executable per folder. Under catkin they belong to `run_tests`; without, to ctest.
if(SCENECALIB_CORE_ONLY)
  enable_testing()
  find_package(GTest REQUIRED)
endif()

foreach(folder base geometry sensor mapping tracking segment association calibration evaluation io
        pipeline simulation ros)
  file(GLOB tests CONFIGURE_DEPENDS test/${folder}/*_test.cc)
  if(NOT tests OR NOT TARGET scenecalib_${folder})
    continue()
  endif()
  list(SORT tests)
  set(test scenecalib_${folder}_test)
  if(SCENECALIB_CORE_ONLY)
    add_executable(${test} ${tests})
    target_link_libraries(${test} GTest::gtest GTest::gtest_main)
    add_test(NAME ${folder} COMMAND ${test})
  else()
    catkin_add_gtest(${test} ${tests})
    target_link_libraries(${test} gtest_main)
  endif()
  target_link_libraries(${test} scenecalib_${folder} opencv_calib3d)  # as reference
  target_include_directories(${test} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/test)
  target_compile_definitions(${test} PRIVATE
    SCENECALIB_SOURCE_DIR="${CMAKE_CURRENT_SOURCE_DIR}")
  target_compile_options(${test} PRIVATE -Wall -Wextra -Wpedantic)
endforeach()

# Tests of the programs and nodes; they share one small simulated recording.
if(NOT SCENECALIB_CORE_ONLY)
  find_package(rostest REQUIRED)
  foreach(test offline replay launch)
    add_rostest(test/rostest/${test}.test
      ARGS binaries:=${CATKIN_DEVEL_PREFIX}/${CATKIN_PACKAGE_BIN_DESTINATION}
           data:=${CMAKE_CURRENT_BINARY_DIR}/rostest_data
      DEPENDENCIES ${SCENECALIB_EXECUTABLES})
  endforeach()
endif()
