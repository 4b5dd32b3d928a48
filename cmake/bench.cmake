# Benchmarks and accuracy programs; neither installed nor run by the tests.
# bench/<name>_bench.cc is a Google Benchmark, bench/<name>_main.cc a program <name>.
find_package(benchmark REQUIRED)

add_library(scenecalib_bench bench/point_labels.cc bench/simulated_drive.cc)
target_include_directories(scenecalib_bench PUBLIC ${CMAKE_CURRENT_SOURCE_DIR})
target_link_libraries(scenecalib_bench PUBLIC scenecalib_simulation scenecalib_pipeline
  opencv_imgcodecs opencv_imgproc)
target_compile_options(scenecalib_bench PRIVATE -Wall -Wextra -Wpedantic)

file(GLOB programs CONFIGURE_DEPENDS bench/*_bench.cc bench/*_main.cc)
foreach(program IN LISTS programs)
  get_filename_component(name ${program} NAME_WE)
  string(REGEX REPLACE "_main$" "" name ${name})
  if(name STREQUAL "epipolar_accuracy" AND NOT TARGET scenecalib_ros)
    continue()  # reads a recording
  endif()
  add_executable(${name} ${program})
  target_compile_options(${name} PRIVATE -Wall -Wextra -Wpedantic)
  target_include_directories(${name} PRIVATE ${CMAKE_CURRENT_SOURCE_DIR}/test)  # scenes of the tests
  target_link_libraries(${name} scenecalib_bench)
  if(name STREQUAL "epipolar_accuracy")
    target_link_libraries(${name} scenecalib_ros)
  endif()
  if(name MATCHES "_bench$")
    target_link_libraries(${name} benchmark::benchmark_main)
  endif()
endforeach()
