#include "best_pose.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

namespace scenecalib {
namespace {

using Matrix6 = Eigen::Matrix<double, kNumAxes, kNumAxes>;

/// Gauss-Newton steps, from coarse to fine: the base over which brightness is differentiated, and
/// the difference beyond which a point does not count.
struct SearchStep {
  float gradient_base_px;
  double max_difference;
};
constexpr SearchStep kCoarseSteps[] = {
    {3.0F, 3.0}, {3.0F, 2.0}, {2.5F, 1.5}, {2.0F, 1.0}, {1.5F, 0.8}};
/// Repeated until no step is longer than that share of the perturbations' range on any axis.
constexpr SearchStep kFineStep = {1.0F, kMaxDifference};
constexpr double kConvergedStep = 0.001;
constexpr int kMaxFineSteps = 40;
/// Points that leave at the truncation make the sum flatter than Gauss-Newton thinks, so its steps
/// are short: those that go on in the direction of the last one are lengthened more and more.
constexpr double kMinAlignment = 0.25;  // cosine
constexpr double kGainGrowth = 1.5;
constexpr double kMaxGain = 6.0;

/// Normal equations of the differences that are not truncated.
struct Normal {
  Matrix6 h = Matrix6::Zero();
  ScaledPose b = ScaledPose::Zero();
  double square_sum = 0.0;
  int count = 0;

  void Add(const Normal& other) {
    h += other.h;
    b += other.b;
    square_sum += other.square_sum;
    count += other.count;
  }
};

/// Of a pair of two cameras, some points at a time.
Normal Linearise(const Comparison& comparison, const ScaledPose& pose, const SearchStep& step) {
  constexpr std::size_t kAtOnce = 64;
  struct Places {
    float x[kAtOnce], y[kAtOnce];
  };
  const Eigen::Matrix<float, kNumAxes, 1> p = pose.cast<float>();
  const BandPassImage& image = *comparison.image;
  const float half_px = 0.5F * step.gradient_base_px;
  Normal normal;
  for (std::size_t first = 0; first < comparison.pixels.size(); first += kAtOnce) {
    const std::size_t n = std::min(kAtOnce, comparison.pixels.size() - first);
    Places places;
    for (std::size_t k = 0; k < n; ++k) {
      const Eigen::Vector2f pixel =
          comparison.pixels[first + k] + comparison.pixels_by_pose[first + k] * p;
      places.x[k] = pixel.x();
      places.y[k] = pixel.y();
    }
    float values[kAtOnce];
    image.At(places.x, places.y, n, values);
    // Those that count move up.
    std::size_t point[kAtOnce];
    Eigen::Matrix<float, kAtOnce, 1> difference;
    std::size_t count = 0;
    for (std::size_t k = 0; k < n; ++k) {
      const float d = values[k] - comparison.other_values[first + k];
      if (std::abs(d) >= static_cast<float>(step.max_difference)) continue;
      point[count] = first + k;
      difference[static_cast<Eigen::Index>(count)] = d;
      places.x[count] = places.x[k];
      places.y[count] = places.y[k];
      ++count;
    }
    const auto difference_across = [&](float dx, float dy, float* differences) {
      Places after, before;
      for (std::size_t k = 0; k < count; ++k) {
        after.x[k] = places.x[k] + dx;
        after.y[k] = places.y[k] + dy;
        before.x[k] = places.x[k] - dx;
        before.y[k] = places.y[k] - dy;
      }
      image.At(after.x, after.y, count, differences);
      image.At(before.x, before.y, count, values);
      for (std::size_t k = 0; k < count; ++k) differences[k] -= values[k];
    };
    float along_x[kAtOnce], along_y[kAtOnce];
    difference_across(half_px, 0.0F, along_x);
    difference_across(0.0F, half_px, along_y);
    Eigen::Matrix<float, kNumAxes, Eigen::Dynamic, 0, kNumAxes, kAtOnce> by_pose(kNumAxes, count);
    for (std::size_t k = 0; k < count; ++k) {
      const Eigen::RowVector2f gradient =
          Eigen::RowVector2f(along_x[k], along_y[k]) / step.gradient_base_px;
      by_pose.col(static_cast<Eigen::Index>(k)) =
          (gradient * comparison.pixels_by_pose[point[k]]).transpose();
    }
    const auto differences = difference.head(static_cast<Eigen::Index>(count));
    normal.h += by_pose.lazyProduct(by_pose.transpose()).cast<double>();
    normal.b += by_pose.lazyProduct(differences).cast<double>();
    normal.square_sum += static_cast<double>(differences.squaredNorm());
    normal.count += static_cast<int>(count);
  }
  return normal;
}

class PoseSearch {
 public:
  PoseSearch(const std::vector<Comparison>& comparisons,
             const std::vector<std::vector<std::size_t>>& pairs_of_camera)
      : comparisons_(comparisons), cameras_(pairs_of_camera.size()) {
    for (std::size_t k = 0; k < cameras_.size(); ++k) {
      for (const std::size_t i : pairs_of_camera[k]) {
        if (!comparisons[i].same_camera) cameras_[k].pairs.push_back(i);
      }
    }
  }

  std::vector<ScaledPose> Run() {
    for (const SearchStep& step : kCoarseSteps) Move(step);
    for (Camera& camera : cameras_) camera.last_step.setZero();
    for (int i = 0; i < kMaxFineSteps; ++i) {
      Move(kFineStep);
      for (Camera& camera : cameras_) {
        camera.is_settled |= camera.last_step.cwiseAbs().maxCoeff() < kConvergedStep;
      }
    }
    std::vector<ScaledPose> optima;
    for (const Camera& camera : cameras_) optima.push_back(camera.optimum);
    return optima;
  }

 private:
  struct Camera {
    std::vector<std::size_t> pairs;  ///< comparisons with other cameras
    ScaledPose optimum = ScaledPose::Zero();
    ScaledPose last_step = ScaledPose::Zero();  ///< Gauss-Newton's, before it was lengthened
    double gain = 1.0;
    bool is_settled = false;
  };

  void Move(const SearchStep& step) {
    std::vector<std::pair<std::size_t, std::size_t>> tasks;  // camera, comparison
    for (std::size_t k = 0; k < cameras_.size(); ++k) {
      if (cameras_[k].is_settled) continue;
      for (const std::size_t i : cameras_[k].pairs) tasks.emplace_back(k, i);
    }
    std::vector<Normal> normals(tasks.size());
    tbb::parallel_for(std::size_t{0}, tasks.size(), [&](std::size_t t) {
      const auto& [k, i] = tasks[t];
      normals[t] = Linearise(comparisons_[i], cameras_[k].optimum, step);
    });
    std::vector<Normal> sums(cameras_.size());
    for (std::size_t t = 0; t < tasks.size(); ++t) sums[tasks[t].first].Add(normals[t]);
    for (std::size_t k = 0; k < cameras_.size(); ++k) Step(sums[k], &cameras_[k]);
  }

  static void Step(Normal sum, Camera* camera) {
    if (sum.count == 0) {
      camera->last_step.setZero();
      return;
    }
    // What the images do not show stays at the calibration: a prior of one range per axis.
    const double variance = sum.square_sum / sum.count;
    sum.h.diagonal().array() += variance;
    sum.b += variance * camera->optimum;
    const ScaledPose target = camera->optimum - sum.h.ldlt().solve(sum.b);
    const ScaledPose step = target.cwiseMax(-1.0).cwiseMin(1.0) - camera->optimum;
    const bool goes_on =
        step.dot(camera->last_step) > kMinAlignment * step.norm() * camera->last_step.norm();
    camera->gain = goes_on ? std::min(kGainGrowth * camera->gain, kMaxGain) : 1.0;
    camera->optimum = (camera->optimum + camera->gain * step).cwiseMax(-1.0).cwiseMin(1.0);
    camera->last_step = step;
  }

  const std::vector<Comparison>& comparisons_;
  std::vector<Camera> cameras_;
};

}  // namespace

std::vector<ScaledPose> FindBestPoses(
    const std::vector<Comparison>& comparisons,
    const std::vector<std::vector<std::size_t>>& pairs_of_camera) {
  return PoseSearch(comparisons, pairs_of_camera).Run();
}

}  // namespace scenecalib
