#pragma once

namespace scenecalib {

/// A rig file: a pinhole camera at the lidar's place that looks along x.
inline constexpr char kOneCameraRig[] = R"(
lidar: {topic: /points, frame_id: lidar}
cameras:
  front:
    image_topic: /image
    frame_id: front_optical
    time_offset_s: 0.0
    lidar_from_camera: {translation_m: [0, 0, 0], rotation_xyzw: [-0.5, 0.5, -0.5, 0.5]}
    intrinsics:
      model: plumb_bob
      width_px: 64
      height_px: 48
      focal_px: [40, 40]
      principal_point_px: [31.5, 23.5]
      distortion: [0, 0, 0, 0, 0]
)";

}  // namespace scenecalib
