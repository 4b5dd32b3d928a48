#include "scenecalib/calibration/calibration_problem.h"

#include <cmath>
#include <map>

#include "calibration/downward_rig.h"
#include "scenecalib/base/random.h"

namespace scenecalib {
namespace {

class DownwardCamera : public testing::DownwardRig {
 protected:
  /// Both views see the ground below them; target.pixel is off by `error_px`.
  TransferTerm Term(double source_height_m, double target_height_m, double error_px) const {
    TransferTerm term;
    term.source.map_from_lidar.translation.z() = source_height_m;
    term.target.map_from_lidar.translation.z() = target_height_m;
    term.source.pixel = {500.0, 500.0};
    term.target.pixel = {500.0 + error_px, 500.0};
    term.plane_sigma_m = 0.0;
    return term;
  }

  TrajectoryCorrection no_correction_;
};

TEST_F(DownwardCamera, FarToNearTransfersWeighLessThanNearToFar) {
  std::vector<TransferTerm> terms{Term(8.0, 2.0, 0.0), Term(2.0, 8.0, 0.0)};
  ASSERT_EQ(WhitenTerms(cameras_, no_correction_, &terms), 0);
  // One pixel at 8 m is four at 2 m: variance 1 + 16 against 1 + 1 / 16.
  EXPECT_NEAR(terms[0].whitening(0, 0), 1.0 / std::sqrt(17.0), 1e-9);
  EXPECT_NEAR(terms[1].whitening(0, 0), 1.0 / std::sqrt(1.0 + 1.0 / 16.0), 1e-9);
}

TEST_F(DownwardCamera, TermsThatCannotBeEvaluatedAreRemovedAndCounted) {
  TransferTerm below = Term(8.0, 2.0, 0.0);
  below.target.map_from_lidar.translation.z() = -1.0;  // under the ground, looking down
  std::vector<TransferTerm> terms{below, Term(2.0, 8.0, 0.0)};
  EXPECT_EQ(WhitenTerms(cameras_, no_correction_, &terms), 1);
  EXPECT_EQ(terms.size(), 1U);
}

TEST_F(DownwardCamera, TrackResidualsAreRootMeanSquaresInPixels) {
  std::vector<TransferTerm> terms{Term(2.0, 2.0, 3.0), Term(2.0, 2.0, 4.0), Term(2.0, 2.0, 1.0)};
  terms[2].track = 1;
  const std::vector<TrackResidual> tracks = EvaluateTracks(cameras_, no_correction_, terms);
  ASSERT_EQ(tracks.size(), 2U);
  EXPECT_NEAR(tracks[0].rms_px, std::sqrt((9.0 + 16.0) / 2.0), 1e-9);
  EXPECT_EQ(tracks[1].first_term, 2);
  EXPECT_NEAR(tracks[1].rms_px, 1.0, 1e-9);
}

TEST_F(DownwardCamera, SolvingWithoutTermsIsAnErrorAndNotASuccess) {
  CalibrationProblem problem;
  problem.cameras = &cameras_;
  problem.correction = &no_correction_;
  EXPECT_EQ(problem.Solve().status().code(), Status::Code::kInsufficientData);
}

/// Ten seconds over a road 60 m long. Every term has the same error along x but for its sign:
/// drawn for each term, or for each piece of 4 m of the road.
class StatedDeviation : public testing::DownwardRig {
 protected:
  StatedDeviation() : correction_(0, AddSeconds(0, 10.0), 1.0) {}

  /// Of the rotation, about the camera's axes: what such a road shows without any turn.
  Eigen::Vector3d RotationOf(bool by_piece) {
    constexpr double kErrorPx = 0.2;
    Random random(9);
    std::map<int, double> sign_of_piece;
    for (int piece = -1; piece <= 16; ++piece) {
      sign_of_piece[piece] = random.Uniform() < 0.5 ? -1.0 : 1.0;
    }
    CalibrationProblem problem;
    problem.cameras = &cameras_;
    problem.correction = &correction_;
    problem.correction_prior = correction_prior_;
    problem.residual_sigma = kErrorPx;
    problem.time_offset_s = {0.0};
    problem.priors.resize(1);
    problem.priors[0].initial_lidar_from_camera = cameras_[0].base_lidar_from_camera;
    for (int i = 0; i < 4000; ++i) {
      TransferTerm term;
      term.track = i;
      // Seen in any second: seconds alone do not tell the pieces apart.
      term.target_stamp_ns = AddSeconds(0, random.Uniform(0.0, 9.9));
      const Eigen::Vector3d point(random.Uniform(0.0, 60.0), random.Uniform(-1.0, 1.0), 0.0);
      term.plane_point_in_map_m = point;
      for (TransferView* view : {&term.source, &term.target}) {
        view->map_from_lidar.translation = {point.x() + random.Uniform(-1.0, 1.0),
                                            random.Uniform(-1.0, 1.0), random.Uniform(2.0, 3.0)};
        // Always from below to above: an error turns the camera to the same side in all terms.
        if (view == &term.target) view->map_from_lidar.translation.z() += 1.0;
        view->pixel = See(cameras_[0], view->map_from_lidar.translation, point);
      }
      const double of_term = random.Uniform() < 0.5 ? -1.0 : 1.0;
      const double sign =
          by_piece ? sign_of_piece[static_cast<int>(std::floor(point.x() / 4.0))] : of_term;
      term.target.pixel.x() += kErrorPx * sign;
      problem.terms.push_back(term);
    }
    return problem.EstimateUncertainty().value().stddev[0].rotation_rad;
  }

  TrajectoryCorrection correction_;
  CorrectionPrior correction_prior_;
};

TEST_F(StatedDeviation, GrowsByWhatTheLidarsFrameIsUncertainBy) {
  constexpr double kFrame_rad = 0.01;
  const Eigen::Vector3d of_right_lasers = RotationOf(false);
  correction_prior_.frame_rotation_rad = kFrame_rad;
  const Eigen::Vector3d widened = RotationOf(false);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(widened[axis], std::hypot(of_right_lasers[axis], kFrame_rad), 1e-6) << axis;
  }
}

TEST_F(StatedDeviation, GrowsWhereThePiecesOfASurfaceErrAsOne) {
  const Eigen::Vector3d independent = RotationOf(false);
  const Eigen::Vector3d by_piece = RotationOf(true);
  EXPECT_GT(by_piece.y(), 3.0 * independent.y());
}

}  // namespace
}  // namespace scenecalib
