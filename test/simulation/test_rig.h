#pragma once

#include <gtest/gtest.h>

#include "scenecalib/sensor/camera_factory.h"
#include "scenecalib/simulation/simulator.h"

namespace scenecalib {

/// The default rig with its first two cameras shrunk to `width_px` columns: quick to render.
inline Rig SmallRig(int width_px) {
  const Result<Rig> full = DefaultRig();
  EXPECT_TRUE(full.ok()) << full.status().message();
  Rig rig = *full;
  rig.cameras.resize(2);
  const int height_px = width_px * 5 / 8;
  const double w = width_px;
  const double h = height_px;
  CameraIntrinsics front;
  front.model = "plumb_bob";
  front.width_px = width_px;
  front.height_px = height_px;
  front.focal_px = {0.7 * w, 0.7 * w};
  front.principal_point_px = {0.51 * w, 0.49 * h};
  front.distortion = {-0.06, 0.02, 0.0004, -0.0003, 0.0};
  CameraIntrinsics left = front;
  left.model = "ftheta";
  left.focal_px.clear();
  left.distortion.clear();
  left.polynomial_px = {0.48 * w, 0.0, -0.006 * w, 0.0, 0.0};
  const CameraIntrinsics both[2] = {front, left};
  for (int i = 0; i < 2; ++i) {
    const Result<CameraModelPtr> model = CreateCameraModel(both[i]);
    EXPECT_TRUE(model.ok()) << model.status().message();
    rig.cameras[static_cast<std::size_t>(i)].model = *model;
  }
  return rig;
}

/// A second of driving with a coarse lidar.
inline SimulationOptions SmallOptions() {
  SimulationOptions options;
  options.seed = 5;
  options.duration_s = 1.0;
  options.lidar.rings = 24;
  options.lidar.columns = 180;
  return options;
}

}  // namespace scenecalib
