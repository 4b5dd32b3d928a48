#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "scenecalib/base/random.h"
#include "scenecalib/sensor/camera_model.h"
#include "scenecalib/simulation/scene_tracer.h"
#include "scenecalib/simulation/simulation_options.h"

namespace scenecalib {

/// Where everything is at an instant.
struct RenderInstant {
  Rigid3 map_from_camera;
  std::vector<Rigid3> map_from_object;  ///< of the tracer's moving objects
};

/// What is rendered: one instant, or one for every row of a rolling shutter.
struct RenderView {
  std::vector<RenderInstant> instants;
  std::uint32_t noise_seed = 0;
  float exposure = 1.0F;  ///< relative to the camera's own, e.g. automatic exposure at work
};

/// Light of the scene.
struct Sunlight {
  Eigen::Vector3f towards_sun = Eigen::Vector3f::UnitZ();
  bool shadows = true;
};

/// Renders one camera: one ray per pixel through the exact camera model, more where the pixel lies
/// on the edge of an object or a shadow. Const calls are thread-safe.
class CameraRenderer {
 public:
  /// Draws the camera's own exposure, gamma and vignetting. `camera_from_own_vehicle` is where the
  /// own body (the tracer's last object) is.
  CameraRenderer(const SceneTracer* tracer, CameraModelPtr model,
                 const SimulatedCameraOptions& options, const Sunlight& sunlight,
                 const Rigid3& camera_from_own_vehicle, bool sees_own_vehicle, Random random);

  /// CV_8UC3 (BGR) or CV_8UC1. All of TBB's threads.
  cv::Mat Render(const RenderView& view) const;

  bool sees_own_vehicle() const { return sees_own_vehicle_; }

 private:
  struct Frame;
  struct Sample;

  Eigen::Vector3f RayStep(int x, int y, int step_x, int step_y) const;
  bool IsLit(int x, int y) const { return rays_[Index(x, y)].squaredNorm() > 0.5F; }
  std::size_t Index(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(width_) +
           static_cast<std::size_t>(x);
  }
  struct Band;
  std::vector<Band> BandsOf(int tile, const Frame& frame) const;
  void Shade(const RenderInstant& instant, Sample* samples, std::size_t num_samples,
             bool own_vehicle) const;
  void RenderBand(const Band& band, Frame* frame) const;
  void SmoothBand(const Band& band, Frame* frame) const;
  void DevelopRow(int y, const Frame& frame, cv::Mat* image) const;
  void FindOwnVehicle(const Rigid3& camera_from_own_vehicle);

  const SceneTracer* tracer_;
  SimulatedCameraOptions options_;
  Sunlight sunlight_;
  bool sees_own_vehicle_;
  int width_, height_, tiles_x_, tiles_y_;
  std::vector<Eigen::Vector3f> rays_;  ///< unit, camera frame; zero beyond the lens
  std::vector<float> gain_;            ///< exposure and vignetting per pixel
  std::vector<char> tile_sees_own_;
  std::vector<float> response_;      ///< level of light, 0 to 1 compressed by 1 - exp(-light)
  std::vector<float> noise_levels_;  ///< quantiles of the noise
};

}  // namespace scenecalib
