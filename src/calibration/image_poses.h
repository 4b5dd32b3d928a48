#pragma once

#include <map>

#include "scenecalib/calibration/joint_calibration.h"
#include "scenecalib/sensor/image_pose.h"

namespace scenecalib {

/// Where a camera of the joint solution was in each of its images, by their stamps; images that the
/// trajectory does not cover are left out.
std::map<Timestamp, ImagePose> ImagePosesOf(const JointCamera& camera, int index,
                                            const JointCalibration& joint,
                                            const Trajectory& map_from_lidar);

}  // namespace scenecalib
