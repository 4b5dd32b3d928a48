#include "scenecalib/calibration/track_ransac.h"

#include <tbb/parallel_for.h>

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "scenecalib/base/random.h"
#include "scenecalib/geometry/so3.h"
#include "term_views.h"

namespace scenecalib {
namespace {

constexpr int kSampleIterations = 6;
/// A step that lowers the sample's squared residuals by less than this, in squared sigmas, is the
/// last.
constexpr double kSettledGain = 1e-2;

struct Hypothesis {
  CameraParameters camera;
  double score = std::numeric_limits<double>::infinity();
};

/// What a hypothesis needs to know of the problem.
struct Sampler {
  const CalibrationProblem& problem;
  int camera;
  const std::vector<TrackResidual>& tracks;
  const TermViews& views;
  const std::vector<SourceRay>& rays;  ///< which no hypothesis changes

  bool Evaluate(const TransferTerm& term, const CameraParameters& parameters,
                Eigen::Vector2d* residual, TransferJacobians* jacobians) const {
    return EvaluateTransfer(term.source, parameters, problem.correction->At(term.source_place),
                            term.target, parameters, problem.correction->At(term.target_place),
                            term.plane_point_in_map_m, term.plane_normal_in_map, residual,
                            jacobians);
  }

  /// Information of a vector known by standard deviations along the camera's axes.
  static Eigen::Matrix3d AlongCamera(const Eigen::Vector3d& sigma, const CameraPrior& prior) {
    const Eigen::Matrix3d lidar_from_camera = prior.initial_lidar_from_camera.RotationMatrix();
    return lidar_from_camera * sigma.cwiseAbs2().cwiseInverse().asDiagonal() *
           lidar_from_camera.transpose();
  }

  /// Gauss-Newton on the sample's terms with the pose's prior; false when it breaks down.
  bool Fit(const std::vector<int>& sample, CameraParameters* parameters) const {
    const CameraPrior& prior = problem.priors[camera];
    for (int iteration = 0; iteration < kSampleIterations; ++iteration) {
      Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
      Vector6d gradient = Vector6d::Zero();
      for (const int track : sample) {
        for (int i = 0; i < tracks[track].num_terms; ++i) {
          const TransferTerm& term = problem.terms[tracks[track].first_term + i];
          Eigen::Vector2d residual;
          TransferJacobians jacobians;
          if (!Evaluate(term, *parameters, &residual, &jacobians)) return false;
          Eigen::Matrix<double, 2, 6> jacobian;
          jacobian << jacobians.source.by_rotation + jacobians.target.by_rotation,
              jacobians.source.by_translation + jacobians.target.by_translation;
          jacobian = term.whitening * jacobian / problem.residual_sigma;
          const Eigen::Vector2d whitened = term.whitening * residual / problem.residual_sigma;
          information += jacobian.transpose() * jacobian;
          gradient += jacobian.transpose() * whitened;
        }
      }
      const Eigen::Matrix3d rotation_weight = AlongCamera(prior.rotation_rad, prior);
      const Eigen::Matrix3d translation_weight = AlongCamera(prior.translation_m, prior);
      information.topLeftCorner<3, 3>() += rotation_weight;
      information.bottomRightCorner<3, 3>() += translation_weight;
      gradient.head<3>() += rotation_weight * parameters->rotation_delta_rad;
      gradient.tail<3>() += translation_weight * parameters->translation_delta_m;
      Vector6d step;
      if (problem.free.translation) {
        step = -information.ldlt().solve(gradient);
      } else {
        step.setZero();
        step.head<3>() = -information.topLeftCorner<3, 3>().ldlt().solve(gradient.head<3>());
      }
      if (!step.allFinite()) return false;
      parameters->rotation_delta_rad += step.head<3>();
      parameters->translation_delta_m += step.tail<3>();
      if (-gradient.dot(step) < kSettledGain) break;
    }
    return true;
  }

  /// Whitened RMSE of each of these tracks; infinite where one cannot be evaluated.
  std::vector<double> TrackRmses(const std::vector<int>& of_tracks,
                                 const CameraParameters& parameters) const {
    std::vector<CameraParameters> cameras = *problem.cameras;
    cameras[camera] = parameters;
    const std::vector<ViewPose> poses = views.PosesAt(cameras, *problem.correction);
    std::vector<double> rmses;
    rmses.reserve(of_tracks.size());
    for (const int t : of_tracks) {
      const TrackResidual& track = tracks[t];
      double sum = 0.0;
      for (int i = track.first_term; i < track.first_term + track.num_terms; ++i) {
        Eigen::Vector2d residual;
        if (!views.Evaluate(static_cast<std::size_t>(i), cameras, poses, rays, &residual,
                            nullptr)) {
          sum = std::numeric_limits<double>::infinity();
          break;
        }
        sum += (problem.terms[i].whitening * residual).squaredNorm();
      }
      rmses.push_back(std::sqrt(sum / (2.0 * track.num_terms)));
    }
    return rmses;
  }

  /// Sum of truncated squared track RMSEs: lower is better.
  double Score(const std::vector<int>& scored, const CameraParameters& parameters,
               double threshold) const {
    double score = 0.0;
    for (const double rms : TrackRmses(scored, parameters)) {
      const double truncated = std::min(rms, threshold);
      score += truncated * truncated;
    }
    return score;
  }
};

std::vector<int> RandomSubset(int n, int count, Random* random) {
  std::vector<int> indices(n);
  for (int i = 0; i < n; ++i) indices[i] = i;
  count = std::min(n, count);
  for (int i = 0; i < count; ++i) {
    std::swap(indices[i], indices[i + static_cast<int>(random->Index(n - i))]);
  }
  indices.resize(count);
  return indices;
}

}  // namespace

TrackRansacResult RansacTracks(const CalibrationProblem& problem, int camera,
                               const TrackRansacOptions& options, std::uint64_t seed) {
  const std::vector<TrackResidual> tracks =
      EvaluateTracks(*problem.cameras, *problem.correction, problem.terms);
  const TermViews views(problem.terms);
  const std::vector<SourceRay> rays = views.RaysAt(*problem.cameras, false);
  const Sampler sampler{problem, camera, tracks, views, rays};
  const Random random(seed);
  const int num_tracks = static_cast<int>(tracks.size());

  TrackRansacResult result;
  result.camera = (*problem.cameras)[camera];
  result.threshold_whitened = options.inlier_sigmas * problem.residual_sigma;
  Random scored_random = random.Fork(0);
  const std::vector<int> scored =
      RandomSubset(num_tracks, options.max_scored_tracks, &scored_random);

  std::vector<Hypothesis> hypotheses(options.num_hypotheses + 1);
  tbb::parallel_for(0, options.num_hypotheses + 1, [&](int h) {
    Hypothesis& hypothesis = hypotheses[h];
    hypothesis.camera = result.camera;
    if (h > 0) {
      Random own = random.Fork(h);
      if (!sampler.Fit(RandomSubset(num_tracks, options.sample_tracks, &own), &hypothesis.camera)) {
        return;
      }
    }
    hypothesis.score = sampler.Score(scored, hypothesis.camera, result.threshold_whitened);
  });
  const auto best =
      std::min_element(hypotheses.begin(), hypotheses.end(),
                       [](const Hypothesis& a, const Hypothesis& b) { return a.score < b.score; });
  result.camera = best->camera;
  result.from_sample = best != hypotheses.begin();
  std::vector<int> all(tracks.size());
  std::iota(all.begin(), all.end(), 0);
  for (const double rms : sampler.TrackRmses(all, result.camera)) {
    const bool inlier = rms < result.threshold_whitened;
    result.is_inlier.push_back(inlier);
    if (inlier) ++result.num_inliers;
  }
  return result;
}

}  // namespace scenecalib
