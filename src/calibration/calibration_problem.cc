#include "scenecalib/calibration/calibration_problem.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "problem_assembly.h"

namespace scenecalib {
namespace {

double MedianAbsolute(std::vector<double>* values) {
  if (values->empty()) return 0.0;
  const auto middle = values->begin() + static_cast<std::ptrdiff_t>(values->size() / 2);
  std::nth_element(values->begin(), middle, values->end());
  return *middle;
}

bool EvaluateTerm(const std::vector<CameraParameters>& cameras,
                  const TrajectoryCorrection& correction, const TransferTerm& term,
                  Eigen::Vector2d* residual, TransferJacobians* jacobians) {
  return EvaluateTransfer(term.source, cameras[term.source_camera],
                          correction.At(term.source_place), term.target,
                          cameras[term.target_camera], correction.At(term.target_place),
                          term.plane_point_in_map_m, term.plane_normal_in_map, residual, jacobians);
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
  options.function_tolerance = 1e-7;
  options.num_threads = 1;  // threads would sum in an order that changes from run to run
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, assembled.problem.get(), &summary);
  if (!summary.IsSolutionUsable()) {
    *cameras = cameras_before;
    *correction = correction_before;
    return Status::NumericalFailure("the solver broke down: " + summary.message);
  }
  SolveEvidence evidence;
  evidence.converged = summary.termination_type == ceres::CONVERGENCE;
  evidence.iterations = static_cast<int>(summary.iterations.size());
  evidence.num_terms = static_cast<int>(terms.size());
  evidence.initial_cost = summary.initial_cost;
  evidence.final_cost = summary.final_cost;
  return evidence;
}

int WhitenTerms(const std::vector<CameraParameters>& cameras,
                const TrajectoryCorrection& correction, std::vector<TransferTerm>* terms) {
  const std::size_t before = terms->size();
  std::vector<TransferTerm> kept;
  kept.reserve(before);
  for (TransferTerm& term : *terms) {
    Eigen::Vector2d residual;
    TransferJacobians jacobians;
    if (!EvaluateTerm(cameras, correction, term, &residual, &jacobians)) continue;
    const Eigen::Matrix2d covariance = term.target_covariance_px2 +
                                       jacobians.by_source_pixel * term.source_covariance_px2 *
                                           jacobians.by_source_pixel.transpose() +
                                       term.plane_sigma_m * term.plane_sigma_m *
                                           jacobians.by_plane_offset *
                                           jacobians.by_plane_offset.transpose();
    const Eigen::LLT<Eigen::Matrix2d> llt(covariance);
    if (llt.info() != Eigen::Success || !covariance.allFinite()) continue;
    term.whitening = llt.matrixL().solve(Eigen::Matrix2d::Identity());
    kept.push_back(term);
  }
  *terms = std::move(kept);
  return static_cast<int>(before - terms->size());
}

std::vector<TrackResidual> EvaluateTracks(const std::vector<CameraParameters>& cameras,
                                          const TrajectoryCorrection& correction,
                                          const std::vector<TransferTerm>& terms) {
  std::vector<TrackResidual> tracks;
  for (std::size_t i = 0; i < terms.size(); ++i) {
    if (i == 0 || terms[i].track != terms[i - 1].track ||
        terms[i].source_camera != terms[i - 1].source_camera) {
      TrackResidual track;
      track.first_term = static_cast<int>(i);
      track.valid = true;
      tracks.push_back(track);
    }
    TrackResidual& track = tracks.back();
    ++track.num_terms;
    Eigen::Vector2d residual;
    if (!EvaluateTerm(cameras, correction, terms[i], &residual, nullptr)) {
      track.valid = false;
      continue;
    }
    track.rms_px += residual.squaredNorm();
    track.rms_whitened += (terms[i].whitening * residual).squaredNorm();
  }
  for (TrackResidual& track : tracks) {
    track.rms_px = std::sqrt(track.rms_px / track.num_terms);
    // Per component, so that 1 is what the covariance promises.
    track.rms_whitened = std::sqrt(track.rms_whitened / (2.0 * track.num_terms));
  }
  return tracks;
}

double RobustResidualSigma(const std::vector<CameraParameters>& cameras,
                           const TrajectoryCorrection& correction,
                           const std::vector<TransferTerm>& terms) {
  std::vector<double> components;
  components.reserve(2 * terms.size());
  for (const TransferTerm& term : terms) {
    Eigen::Vector2d residual;
    if (!EvaluateTerm(cameras, correction, term, &residual, nullptr)) continue;
    const Eigen::Vector2d whitened = term.whitening * residual;
    components.push_back(std::abs(whitened.x()));
    components.push_back(std::abs(whitened.y()));
  }
  return 1.4826 * MedianAbsolute(&components);
}

}  // namespace scenecalib
