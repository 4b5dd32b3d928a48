#include "scenecalib/ros/simulate.h"

int main(int argc, char** argv) { return scenecalib::RunSimulate(argc, argv); }
