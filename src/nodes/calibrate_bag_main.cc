#include "scenecalib/ros/calibrate_bag.h"

int main(int argc, char** argv) { return scenecalib::RunCalibrateBag(argc, argv); }
