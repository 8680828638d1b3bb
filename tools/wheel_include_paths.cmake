# ROS from wheels: lets CMake configure against packages that were built on another machine.
#
# The CMake exports of the wheels name the Python include folder of the machine that built them, and
# CMake refuses imported targets with an include folder that does not exist. Given as
# CMAKE_PROJECT_INCLUDE, this file drops those folders (and nothing else) when the project has been
# read and before CMake generates. Python's own headers are found through Python3_EXECUTABLE.
# On a ROS installation there is nothing to drop.

function(drop_foreign_python_includes)
  get_property(targets DIRECTORY PROPERTY IMPORTED_TARGETS)
  foreach(target IN LISTS targets)
    get_target_property(folders ${target} INTERFACE_INCLUDE_DIRECTORIES)
    if(folders)
      list(FILTER folders EXCLUDE REGEX "^/opt/python/cp3")
      set_target_properties(${target} PROPERTIES INTERFACE_INCLUDE_DIRECTORIES "${folders}")
    endif()
  endforeach()
endfunction()

cmake_language(DEFER CALL drop_foreign_python_includes)
