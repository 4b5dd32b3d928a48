#include "scenecalib/calibration/calibration_problem.h"

#include <ceres/ceres.h>
#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "problem_assembly.h"
#include "term_views.h"

namespace scenecalib {
namespace {

double MedianAbsolute(std::vector<double>* values) {
  if (values->empty()) return 0.0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

}  // namespace

Result<SolveEvidence> CalibrationProblem::Solve() {
  if (terms.empty()) return Status::InsufficientData("no correspondences to solve on");
  const std::vector<CameraParameters> cameras_before = *cameras;
  const TrajectoryCorrection correction_before = *correction;
  const AssembledProblem assembled = AssembleProblem(*this);
  ceres::Solver::Options options;
  options.linear_solver_type =
      free.correction ? ceres::SPARSE_NORMAL_CHOLESKY : ceres::DENSE_NORMAL_CHOLESKY;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = function_tolerance;
  options.num_threads = 1;  // threads would sum in an order that changes from run to run
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  SolveAssembled(assembled, options, &summary);
  if (!summary.IsSolutionUsable()) {
    *cameras = cameras_before;
    *correction = correction_before;
    return Status::NumericalFailure("the solver broke down: " + summary.message);
  }
  SolveEvidence evidence;
  evidence.converged = summary.termination_type == ceres::CONVERGENCE ||
                       summary.termination_type == ceres::USER_SUCCESS;
  evidence.iterations = static_cast<int>(summary.iterations.size());
  evidence.num_terms = static_cast<int>(terms.size());
  evidence.initial_cost = summary.initial_cost;
  evidence.final_cost = summary.final_cost;
  return evidence;
}

int WhitenTerms(const std::vector<CameraParameters>& cameras,
                const TrajectoryCorrection& correction, std::vector<TransferTerm>* terms) {
  const TermViews views(*terms);
  const std::vector<ViewPose> poses = views.PosesAt(cameras, correction);
  const std::vector<SourceRay> rays = views.RaysAt(cameras, true);
  std::vector<char> is_good(terms->size(), 0);
  tbb::parallel_for(std::size_t{0}, terms->size(), [&](std::size_t i) {
    TransferTerm& term = (*terms)[i];
    Eigen::Vector2d residual;
    PoseJacobians jacobians;
    if (!views.Evaluate(i, cameras, poses, rays, &residual, &jacobians)) return;
    const Eigen::Matrix2d covariance = term.target_covariance_px2 +
                                       jacobians.by_source_pixel * term.source_covariance_px2 *
                                           jacobians.by_source_pixel.transpose() +
                                       term.plane_sigma_m * term.plane_sigma_m *
                                           jacobians.by_plane_offset *
                                           jacobians.by_plane_offset.transpose();
    const Eigen::LLT<Eigen::Matrix2d> llt(covariance);
    if (llt.info() != Eigen::Success || !covariance.allFinite()) return;
    term.whitening = llt.matrixL().solve(Eigen::Matrix2d::Identity());
    is_good[i] = 1;
  });
  std::vector<TransferTerm> kept;
  kept.reserve(terms->size());
  for (std::size_t i = 0; i < terms->size(); ++i) {
    if (is_good[i] != 0) kept.push_back((*terms)[i]);
  }
  const auto num_dropped = static_cast<int>(terms->size() - kept.size());
  *terms = std::move(kept);
  return num_dropped;
}

std::vector<TrackResidual> EvaluateTracks(const std::vector<CameraParameters>& cameras,
                                          const TrajectoryCorrection& correction,
                                          const std::vector<TransferTerm>& terms) {
  const TermViews views(terms);
  const std::vector<ViewPose> poses = views.PosesAt(cameras, correction);
  const std::vector<SourceRay> rays = views.RaysAt(cameras, false);
  std::vector<TrackResidual> tracks;
  for (std::size_t i = 0; i < terms.size(); ++i) {
    if (i == 0 || terms[i].track != terms[i - 1].track ||
        terms[i].source_camera != terms[i - 1].source_camera) {
      TrackResidual track;
      track.first_term = static_cast<int>(i);
      track.valid = true;
      tracks.push_back(track);
    }
    ++tracks.back().num_terms;
  }
  tbb::parallel_for(std::size_t{0}, tracks.size(), [&](std::size_t t) {
    TrackResidual& track = tracks[t];
    for (int i = track.first_term; i < track.first_term + track.num_terms; ++i) {
      const auto term = static_cast<std::size_t>(i);
      Eigen::Vector2d residual;
      if (!views.Evaluate(term, cameras, poses, rays, &residual, nullptr)) {
        track.valid = false;
        continue;
      }
      track.rms_px += residual.squaredNorm();
      track.rms_whitened += (terms[term].whitening * residual).squaredNorm();
    }
    track.rms_px = std::sqrt(track.rms_px / track.num_terms);
    // Per component, so that 1 is what the covariance promises.
    track.rms_whitened = std::sqrt(track.rms_whitened / (2.0 * track.num_terms));
  });
  return tracks;
}

double RobustResidualSigma(const std::vector<CameraParameters>& cameras,
                           const TrajectoryCorrection& correction,
                           const std::vector<TransferTerm>& terms) {
  const TermViews views(terms);
  const std::vector<ViewPose> poses = views.PosesAt(cameras, correction);
  const std::vector<SourceRay> rays = views.RaysAt(cameras, false);
  constexpr double kNone = -1.0;
  std::vector<double> components(2 * terms.size(), kNone);
  tbb::parallel_for(std::size_t{0}, terms.size(), [&](std::size_t i) {
    Eigen::Vector2d residual;
    if (!views.Evaluate(i, cameras, poses, rays, &residual, nullptr)) return;
    const Eigen::Vector2d whitened = terms[i].whitening * residual;
    components[2 * i] = std::abs(whitened.x());
    components[2 * i + 1] = std::abs(whitened.y());
  });
  components.erase(std::remove(components.begin(), components.end(), kNone), components.end());
  return 1.4826 * MedianAbsolute(&components);
}

}  // namespace scenecalib
