#include "image_poses.h"

#include <optional>

namespace scenecalib {

std::map<Timestamp, ImagePose> ImagePosesOf(const JointCamera& camera, int index,
                                            const JointCalibration& joint,
                                            const Trajectory& map_from_lidar) {
  const auto c = static_cast<std::size_t>(index);
  const CameraParameters& parameters = joint.cameras[c];
  const Rigid3 lidar_from_camera = parameters.LidarFromCamera();
  const auto corrected = [&](Timestamp stamp_ns) -> std::optional<Rigid3> {
    const auto pose = map_from_lidar.Interpolate(stamp_ns);
    if (!pose) return std::nullopt;
    return joint.correction.Apply(*pose, stamp_ns);
  };
  std::map<Timestamp, ImagePose> poses;
  for (const auto& image : camera.segment->images) {
    const auto pose = ImagePoseAt(AddSeconds(image.first, joint.time_offset_s[c]),
                                  parameters.rolling_shutter_line_time_s,
                                  parameters.model->height_px(), lidar_from_camera, corrected);
    if (pose) poses[image.first] = *pose;
  }
  return poses;
}

}  // namespace scenecalib
