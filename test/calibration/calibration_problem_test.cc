#include "scenecalib/calibration/calibration_problem.h"

#include <gtest/gtest.h>

#include <cmath>

#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

/// A pinhole that looks straight down on the ground z = 0 from the heights of its views.
class DownwardCamera : public ::testing::Test {
 protected:
  DownwardCamera() {
    CameraIntrinsics intrinsics;
    intrinsics.model = "plumb_bob";
    intrinsics.width_px = 1000;
    intrinsics.height_px = 1000;
    intrinsics.focal_px = {400.0, 400.0};
    intrinsics.principal_point_px = {500.0, 500.0};
    intrinsics.distortion = {0.0, 0.0, 0.0, 0.0, 0.0};
    model_ = CreateCameraModel(intrinsics).value();
    cameras_.resize(1);
    cameras_[0].model = model_.get();
    cameras_[0].intrinsics << 1.0, 500.0, 500.0;
    Eigen::Matrix3d down;
    down << 1, 0, 0, 0, -1, 0, 0, 0, -1;
    cameras_[0].base_lidar_from_camera = Rigid3(Eigen::Quaterniond(down), Eigen::Vector3d::Zero());
  }

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

  CameraModelPtr model_;
  std::vector<CameraParameters> cameras_;
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

}  // namespace
}  // namespace scenecalib
