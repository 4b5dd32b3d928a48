#include "scenecalib/evaluation/rig_comparison.h"

#include <algorithm>
#include <cmath>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr int kGridSteps = 24;  // pixels per axis
constexpr double kRangesM[] = {5.0, 10.0, 20.0, 50.0};

/// Mean radius on the image, px, of rays 0.1 rad off the optical axis.
double CentralRadius(const CameraModel& camera) {
  constexpr double kThetaRad = 0.1;
  constexpr int kDirections = 8;
  double sum_px = 0.0;
  int count = 0;
  for (int i = 0; i < kDirections; ++i) {
    const double phi = 2.0 * 3.14159265358979323846 * i / kDirections;
    const Eigen::Vector3d ray(std::sin(kThetaRad) * std::cos(phi),
                              std::sin(kThetaRad) * std::sin(phi), std::cos(kThetaRad));
    const auto pixel = camera.ProjectTuned(ray, camera.tunable(), nullptr);
    if (!pixel) continue;  // only a lens narrower than 12 degrees
    sum_px += (*pixel - camera.tunable().principal_point_px).norm();
    ++count;
  }
  return count > 0 ? sum_px / count : std::nan("");
}

void CompareProjections(const CameraConfig& truth, const CameraConfig& estimate,
                        CameraError* error) {
  const Rigid3 estimated_from_true = estimate.lidar_from_camera.Inverse() * truth.lidar_from_camera;
  double sum_px2 = 0.0;
  for (int row = 0; row < kGridSteps; ++row) {
    for (int column = 0; column < kGridSteps; ++column) {
      const Eigen::Vector2d pixel((column + 0.5) / kGridSteps * truth.model->width_px() - 0.5,
                                  (row + 0.5) / kGridSteps * truth.model->height_px() - 0.5);
      const auto ray = truth.model->Unproject(pixel);
      if (!ray) continue;  // outside the image circle
      for (const double range_m : kRangesM) {
        const auto projected = estimate.model->ProjectTuned(
            estimated_from_true * (range_m * *ray).eval(), estimate.model->tunable(), nullptr);
        if (!projected) {
          ++error->num_unprojected_points;
          continue;
        }
        sum_px2 += (*projected - pixel).squaredNorm();
        ++error->num_points;
      }
    }
  }
  error->reprojection_rms_px =
      error->num_points > 0 ? std::sqrt(sum_px2 / error->num_points) : std::nan("");
}

}  // namespace

Result<std::vector<CameraError>> CompareRigs(const Rig& truth, const Rig& estimate) {
  std::vector<CameraError> errors;
  for (const CameraConfig& expected : truth.cameras) {
    const auto found = std::find_if(
        estimate.cameras.begin(), estimate.cameras.end(),
        [&expected](const CameraConfig& camera) { return camera.name == expected.name; });
    if (found == estimate.cameras.end()) {
      return Status::NotFound("camera " + expected.name + " of the truth is not in the estimate");
    }
    if (!expected.model || !found->model) {
      return Status::InvalidArgument("camera " + expected.name + " has no intrinsics");
    }
    CameraError error;
    error.name = expected.name;
    const Rigid3 true_from_estimated =
        expected.lidar_from_camera.Inverse() * found->lidar_from_camera;
    error.rotation_rad = LogSo3(true_from_estimated.rotation);
    error.translation_m = true_from_estimated.translation;
    error.time_offset_s = found->time_offset_s - expected.time_offset_s;
    error.focal_scale = CentralRadius(*found->model) / CentralRadius(*expected.model) - 1.0;
    error.principal_point_px =
        found->model->tunable().principal_point_px - expected.model->tunable().principal_point_px;
    CompareProjections(expected, *found, &error);
    errors.push_back(error);
  }
  return errors;
}

}  // namespace scenecalib
