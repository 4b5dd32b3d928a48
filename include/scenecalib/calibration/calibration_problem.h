#pragma once

#include <Eigen/Core>
#include <vector>

#include "scenecalib/base/status.h"
#include "scenecalib/calibration/calibration_result.h"
#include "scenecalib/calibration/clock_misfit.h"
#include "scenecalib/calibration/radial_misfit.h"
#include "scenecalib/calibration/trajectory_correction.h"
#include "scenecalib/calibration/transfer_error.h"
#include "scenecalib/mapping/ray_caster.h"

namespace scenecalib {

/// One transfer of Eq. (3): a track's pixel in its reference view against its pixel in another
/// view.
struct TransferTerm {
  int track = 0;  ///< index of the track; the terms of one track are neighbours
  int source_camera = 0;
  int target_camera = 0;
  TransferView source;
  TransferView target;
  TrajectoryCorrection::Place source_place;
  TrajectoryCorrection::Place target_place;
  Eigen::Matrix2d source_covariance_px2 = Eigen::Matrix2d::Identity();
  Eigen::Matrix2d target_covariance_px2 = Eigen::Matrix2d::Identity();
  Eigen::Vector3d plane_point_in_map_m = Eigen::Vector3d::Zero();
  Eigen::Vector3d plane_normal_in_map = Eigen::Vector3d::UnitZ();
  double plane_sigma_m = 0.005;
  SurfaceKind surface = SurfaceKind::kGround;
  Timestamp target_stamp_ns = 0;
  /// W with W^T W = inverse covariance of the residual; set by WhitenTerms.
  Eigen::Matrix2d whitening = Eigen::Matrix2d::Identity();
};

/// Prior standard deviations of one camera's parameters about the initial rig; of the pose in the
/// camera frame's axes.
struct CameraPrior {
  Rigid3 initial_lidar_from_camera;
  Eigen::Vector3d initial_intrinsics = Eigen::Vector3d(1.0, 0.0, 0.0);
  Eigen::Vector3d rotation_rad = Eigen::Vector3d::Constant(0.05);
  Eigen::Vector3d translation_m = Eigen::Vector3d::Constant(0.3);
  double focal_scale = 0.01;
  Eigen::Vector2d principal_point_px = Eigen::Vector2d::Constant(8.0);
  double time_offset_s = 0.02;
  double initial_time_offset_s = 0.0;

  /// Of (s_f, cx, cy).
  Eigen::Vector3d IntrinsicsStddev() const {
    return {focal_scale, principal_point_px.x(), principal_point_px.y()};
  }
};

/// What a solve may move.
struct FreeParameters {
  bool rotation = true;
  bool translation = true;
  bool intrinsics = false;
  bool time_offset = false;
  bool correction = false;
};

/// Prior of the trajectory correction: a random walk, tied to zero mean so that it cannot stand in
/// for the extrinsics.
struct CorrectionPrior {
  double walk_rotation_rad = 3e-4;   ///< per sqrt(second)
  double walk_translation_m = 5e-3;  ///< per sqrt(second)
  /// What the mean, held at zero, is uncertain by, per axis: the lidar's own frame. It moves
  /// nothing and widens every camera's standard deviations.
  double frame_rotation_rad = 0.0;
  double frame_translation_m = 0.0;
};

struct SolveEvidence {
  bool converged = false;
  int iterations = 0;
  int num_terms = 0;
  double initial_cost = 0.0;
  double final_cost = 0.0;
};

/// How sure a solution is, parallel to its cameras.
struct CalibrationUncertainty {
  std::vector<CameraStddev> stddev;
  std::vector<RadialMisfit> lenses;
  std::vector<ClockMisfit> clocks;
};

/// The nonlinear least-squares problem over a set of terms: Eq. (3), whitened and robust, with
/// priors. Cameras and correction are changed in place by Solve.
struct CalibrationProblem {
  static constexpr double kFinalTolerance = 1e-7;
  /// Enough where the terms are chosen anew afterwards.
  static constexpr double kRoughTolerance = 1e-5;

  std::vector<CameraParameters>* cameras = nullptr;
  std::vector<CameraPrior> priors;    ///< parallel to cameras
  std::vector<double> time_offset_s;  ///< of each camera, before its delta; parallel to cameras
  TrajectoryCorrection* correction = nullptr;
  CorrectionPrior correction_prior;
  std::vector<TransferTerm> terms;
  FreeParameters free;
  /// The intrinsics' prior counts as so many times tighter than it is: as much as the data's formal
  /// covariance may be too small (PriorOptions::formal_optimism).
  double intrinsics_prior_weight = 1.0;
  /// True when the radial coefficients of the lenses follow the data (from one solve to the next).
  bool lenses_follow = false;
  double loss_scale = 2.0;      ///< Cauchy, in units of the whitened residual's sigma
  double residual_sigma = 1.0;  ///< what one unit of whitened residual is worth (estimated)
  int max_iterations = 30;
  /// A solve ends when the cost changes by less than this share.
  double function_tolerance = kFinalTolerance;

  /// NumericalFailure when the solver breaks down; the parameters are then as before.
  Result<SolveEvidence> Solve();

  /// Standard deviations of every camera at the present parameters, a solution: the largest of the
  /// formal covariance and of two sandwich estimates, over seconds of time and over pieces of
  /// surface, which see errors that the terms of one stretch of road or of one wall share; and what
  /// lenses that do not fit their images add to each. What the data does not show has its prior's
  /// (docs/math.md, section 6).
  Result<CalibrationUncertainty> EstimateUncertainty() const;
};

/// Sets each term's whitening from the pixel covariances carried through the transfer and the
/// surface's uncertainty along its normal, so that far-to-near transfers do not drown the rest.
/// Removes terms that cannot be evaluated at the present parameters and returns how many.
int WhitenTerms(const std::vector<CameraParameters>& cameras,
                const TrajectoryCorrection& correction, std::vector<TransferTerm>* terms);

/// Root mean square of the residuals of every track, px and whitened; the order of `first_terms`.
struct TrackResidual {
  int first_term = 0;
  int num_terms = 0;
  double rms_px = 0.0;
  double rms_whitened = 0.0;
  bool valid = false;  ///< false when a term cannot be evaluated
};
std::vector<TrackResidual> EvaluateTracks(const std::vector<CameraParameters>& cameras,
                                          const TrajectoryCorrection& correction,
                                          const std::vector<TransferTerm>& terms);

/// Robust standard deviation of one whitened residual component (1.4826 MAD about zero).
double RobustResidualSigma(const std::vector<CameraParameters>& cameras,
                           const TrajectoryCorrection& correction,
                           const std::vector<TransferTerm>& terms);

}  // namespace scenecalib
