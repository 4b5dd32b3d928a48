#include "scenecalib/ros/study_tools.h"

int main(int argc, char** argv) { return scenecalib::RunCompare(argc, argv); }
