#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <cstdint>

#include "scenecalib/geometry/so3.h"
#include "scenecalib/simulation/inertial.h"
#include "scenecalib/simulation/road_curve.h"
#include "scenecalib/simulation/vehicle_motion.h"

namespace scenecalib {
namespace {

RoadCurve CurvyRoad() { return {"turns", -80.0, 120.0, 180.0, 15.0, Random(3)}; }

VehicleMotion Drive(const RoadCurve& road) {
  return {road, SimulatedDriveOptions(), -0.2, 8.2, Random(4)};
}

TEST(RoadCurve, IsParametrisedByArcLengthWithCurvatureAsTheRateOfItsHeading) {
  const RoadCurve road = CurvyRoad();
  const double step = 1e-3;
  for (double s = -70.0; s < 170.0; s += 1.7) {
    const Eigen::Vector3d tangent =
        (road.Point(s + step, 0.0, 0.0) - road.Point(s - step, 0.0, 0.0)) / (2.0 * step);
    EXPECT_NEAR(tangent.head<2>().norm(), 1.0, 1e-4);
    EXPECT_NEAR(std::atan2(tangent.y(), tangent.x()), std::remainder(road.Heading(s), 2.0 * M_PI),
                1e-3);
    const double turn = (road.Heading(s + step) - road.Heading(s - step)) / (2.0 * step);
    EXPECT_NEAR(turn, road.Curvature(s), 1e-6);
  }
  EXPECT_LT(road.Point(0.0, 0.0, 0.0).head<2>().norm(), 1e-9);
}

TEST(RoadCurve, TurnsAtARightAngleNoSharperThanItsCorner) {
  const RoadCurve road = CurvyRoad();
  double sharpest = 0.0;
  double turned = 0.0;
  for (double s = 0.0; s < 120.0; s += 0.5) {
    sharpest = std::max(sharpest, std::abs(road.Curvature(s)));
    turned = std::max(turned, std::abs(road.Heading(s)));
  }
  EXPECT_LE(sharpest, 1.0 / 15.0 + 1e-6);
  EXPECT_GE(turned, 0.9);
}

TEST(RoadCurve, NeverMeetsItselfOnALongDrive) {
  for (std::uint64_t seed = 1; seed < 9; ++seed) {
    const RoadCurve road("turns", -60.0, 1500.0, 1560.0, 15.0, Random(seed));
    for (double s = -60.0; s < 1560.0; s += 5.0) {
      EXPECT_LT(std::abs(road.Heading(s)), 2.2);
      // Houses reach 18 m to either side of the road.
      for (double later = s + 90.0; later < 1560.0; later += 5.0) {
        const Eigen::Vector3d apart = road.Point(later, 0.0, 0.0) - road.Point(s, 0.0, 0.0);
        ASSERT_GT(apart.head<2>().norm(), 36.0) << "seed " << seed << " at " << s << ", " << later;
      }
    }
  }
}

TEST(VehicleMotion, HasTheDerivativesOfItsPoses) {
  const RoadCurve road = CurvyRoad();
  const VehicleMotion motion = Drive(road);
  const double h = 1e-4;
  for (double t = 0.0; t < 8.0; t += 0.37) {
    const VehicleState state = motion.At(t);
    const Rigid3 before = motion.MapFromVehicle(t - h);
    const Rigid3 after = motion.MapFromVehicle(t + h);
    const Eigen::Vector3d here = state.map_from_vehicle.translation;
    const Eigen::Vector3d velocity = (after.translation - before.translation) / (2.0 * h);
    const Eigen::Vector3d acceleration =
        (after.translation - 2.0 * here + before.translation) / (h * h);
    const Eigen::Vector3d rate = LogSo3(before.rotation.conjugate() * after.rotation) / (2.0 * h);
    EXPECT_LT((velocity - state.velocity_in_map_m_s).norm(), 1e-5);
    EXPECT_LT((acceleration - state.acceleration_in_map_m_s2).norm(), 1e-4);
    EXPECT_LT((rate - state.angular_velocity_in_vehicle_rad_s).norm(), 1e-5);
    const Eigen::Vector3d angular_acceleration =
        (motion.At(t + h).angular_velocity_in_vehicle_rad_s -
         motion.At(t - h).angular_velocity_in_vehicle_rad_s) /
        (2.0 * h);
    EXPECT_LT((angular_acceleration - state.angular_acceleration_in_vehicle_rad_s2).norm(), 1e-5);
  }
}

TEST(VehicleMotion, DrivesForwardOnTheRightOfTheRoad) {
  const RoadCurve road = CurvyRoad();
  const VehicleMotion motion = Drive(road);
  for (double t = 0.0; t < 8.0; t += 0.5) {
    const VehicleState state = motion.At(t);
    const double s = motion.ArcLength(t);
    const Eigen::Vector3d from_centreline =
        state.map_from_vehicle.translation - road.Point(s, 0.0, 0.0);
    EXPECT_NEAR(from_centreline.dot(road.Left(s)), -1.65, 0.35);
    EXPECT_LT(std::abs(from_centreline.z()), 0.1);
    const Eigen::Vector3d forward =
        state.map_from_vehicle.rotation.conjugate() * state.velocity_in_map_m_s;
    EXPECT_GT(forward.x(), 2.0);
    EXPECT_LT(std::abs(forward.y()), 0.3);
  }
}

TEST(PerfectImu, IntegratesToTheMotionOfItsMount) {
  const RoadCurve road = CurvyRoad();
  const VehicleMotion motion = Drive(road);
  const Rigid3 vehicle_from_imu(ExpSo3({0.1, -0.2, 0.3}), {1.3, -0.4, 0.8});
  const auto map_from_imu_at = [&](double t) {
    return motion.MapFromVehicle(t) * vehicle_from_imu;
  };
  const double start = 1.0;
  const double step = 1e-3;
  const int steps = 4000;
  Rigid3 map_from_imu = map_from_imu_at(start);
  Eigen::Vector3d velocity =
      (map_from_imu_at(start + 1e-5).translation - map_from_imu_at(start - 1e-5).translation) /
      2e-5;
  for (int i = 0; i < steps; ++i) {  // midpoint rule
    const ImuSample sample = PerfectImu(motion.At(start + (i + 0.5) * step), vehicle_from_imu);
    const Eigen::Quaterniond middle =
        map_from_imu.rotation * ExpSo3(0.5 * step * sample.angular_velocity_rad_s);
    const Eigen::Vector3d acceleration =
        middle * sample.linear_acceleration_m_s2 + Eigen::Vector3d(0.0, 0.0, -kGravityM_s2);
    map_from_imu.translation += step * velocity + 0.5 * step * step * acceleration;
    velocity += step * acceleration;
    map_from_imu.rotation =
        (map_from_imu.rotation * ExpSo3(step * sample.angular_velocity_rad_s)).normalized();
  }
  const Rigid3 truth = map_from_imu_at(start + steps * step);
  EXPECT_LT(RotationAngle(map_from_imu.rotation, truth.rotation), 1e-5);
  EXPECT_LT((map_from_imu.translation - truth.translation).norm(), 1e-3);
}

TEST(SimulateImu, AddsNoiseOfTheGivenSizeAboutAConstantBias) {
  std::vector<Timestamp> stamps;
  for (int i = 0; i < 4000; ++i) stamps.push_back(5'000'000LL * i);
  SimulatedImuOptions options;
  options.gyro_noise_rad_s = 0.01;
  options.gyro_walk_rad_s_sqrt_s = 0.0;
  const auto samples = SimulateImu(
      stamps, [](Timestamp) { return VehicleState(); }, Rigid3(), options, Random(1));
  double sum = 0.0;
  double sum2 = 0.0;
  for (const ImuSample& sample : samples) {
    sum += sample.angular_velocity_rad_s.x();
    sum2 += sample.angular_velocity_rad_s.x() * sample.angular_velocity_rad_s.x();
    EXPECT_NEAR(sample.linear_acceleration_m_s2.z(), kGravityM_s2, 0.4);
  }
  const double mean = sum / 4000.0;
  EXPECT_GT(std::abs(mean), 1e-5);
  EXPECT_LT(std::abs(mean), 5.0 * options.gyro_bias_rad_s);
  EXPECT_NEAR(std::sqrt(sum2 / 4000.0 - mean * mean), 0.01, 0.0005);
}

TEST(SimulateOdometry, FollowsTheBodyExactlyWithoutErrorsAndDriftsWithThem) {
  const RoadCurve road = CurvyRoad();
  const VehicleMotion motion = Drive(road);
  std::vector<Timestamp> stamps;
  for (int i = 0; i < 400; ++i) stamps.push_back(20'000'000LL * i);
  const auto pose_at = [&motion](Timestamp stamp_ns) {
    return motion.MapFromVehicle(SecondsBetween(0, stamp_ns));
  };
  SimulatedOdometryOptions options;
  options.scale_error = options.yaw_drift_deg_s = options.noise_m = options.noise_deg = 0.0;
  const Rigid3 travelled = pose_at(stamps.front()).Inverse() * pose_at(stamps.back());
  const Rigid3 exact = SimulateOdometry(stamps, pose_at, options, Random(1)).back().odom_from_body;
  EXPECT_LT((exact.translation - travelled.translation).norm(), 1e-6);
  EXPECT_LT(RotationAngle(exact.rotation, travelled.rotation), 1e-7);
  const Rigid3 drifted = SimulateOdometry(stamps, pose_at, SimulatedOdometryOptions(), Random(1))
                             .back()
                             .odom_from_body;
  EXPECT_GT((drifted.translation - travelled.translation).norm(), 0.02);
  EXPECT_LT((drifted.translation - travelled.translation).norm(), 3.0);
}

}  // namespace
}  // namespace scenecalib
