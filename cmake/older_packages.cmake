# Targets that the packages of Ubuntu 20.04 do not bring along, under the names of later ones.

function(scenecalib_interface_target name)
  add_library(${name} INTERFACE IMPORTED GLOBAL)
  set_target_properties(${name} PROPERTIES ${ARGN})
endfunction()

# Ceres before 2, which is called ceres. After find_package(Ceres).
function(scenecalib_find_ceres)
  if(NOT TARGET Ceres::ceres)
    scenecalib_interface_target(Ceres::ceres INTERFACE_LINK_LIBRARIES ceres)
  endif()
endfunction()

# Debian's Embree has no package configuration before 3.12.
function(scenecalib_find_embree)
  find_package(embree 3 QUIET)
  if(TARGET embree)
    set_target_properties(embree PROPERTIES IMPORTED_GLOBAL TRUE)
    return()
  endif()
  find_path(EMBREE_INCLUDE_DIR embree3/rtcore.h)
  find_library(EMBREE_LIBRARY embree3)
  if(NOT EMBREE_INCLUDE_DIR OR NOT EMBREE_LIBRARY)
    message(FATAL_ERROR "Embree 3 is missing: install libembree-dev")
  endif()
  scenecalib_interface_target(embree INTERFACE_LINK_LIBRARIES "${EMBREE_LIBRARY}"
    INTERFACE_INCLUDE_DIRECTORIES "${EMBREE_INCLUDE_DIR}")
endfunction()

# CLI11 is a header library, which is copied by hand where there is no package of it.
function(scenecalib_find_cli11)
  find_package(CLI11 QUIET)
  if(TARGET CLI11::CLI11)
    set_target_properties(CLI11::CLI11 PROPERTIES IMPORTED_GLOBAL TRUE)
    return()
  endif()
  find_path(CLI11_INCLUDE_DIR CLI/CLI.hpp)
  if(NOT CLI11_INCLUDE_DIR)
    message(FATAL_ERROR "CLI11 is missing: install libcli11-dev or, where there is no such package, "
      "copy the CLI/ headers of CLI11 2 to /usr/local/include")
  endif()
  scenecalib_interface_target(CLI11::CLI11 INTERFACE_INCLUDE_DIRECTORIES "${CLI11_INCLUDE_DIR}")
endfunction()
