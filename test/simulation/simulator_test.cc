#include "scenecalib/simulation/simulator.h"

#include <gtest/gtest.h>
#include <tbb/global_control.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <map>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>
#include <vector>

#include "scenecalib/geometry/so3.h"
#include "simulation/test_rig.h"

namespace scenecalib {
namespace {

Simulator MakeSimulator(const Rig& rig, const SimulationOptions& options) {
  Result<Simulator> simulator = Simulator::Create(rig, options);
  EXPECT_TRUE(simulator.ok()) << simulator.status().message();
  return std::move(*simulator);
}

bool SamePoints(const LidarScan& a, const LidarScan& b) {
  if (a.stamp_ns != b.stamp_ns || a.points.size() != b.points.size()) return false;
  for (std::size_t i = 0; i < a.points.size(); ++i) {
    const LidarPoint& p = a.points[i];
    const LidarPoint& q = b.points[i];
    if (p.position_in_lidar_m != q.position_in_lidar_m || p.time_offset_s != q.time_offset_s ||
        p.intensity != q.intensity || p.ring != q.ring) {
      return false;
    }
  }
  return true;
}

bool SamePixels(const cv::Mat& a, const cv::Mat& b) {
  return a.size() == b.size() && a.type() == b.type() && cv::norm(a, b, cv::NORM_INF) == 0.0;
}

Timestamp ExposureOf(const Simulator& simulator, int camera, int index) {
  for (const ScheduledMeasurement& m : simulator.schedule()) {
    if (m.kind == MeasurementKind::kImage && m.camera == camera && m.index == index) {
      return m.exposure_ns;
    }
  }
  ADD_FAILURE() << "no such image";
  return 0;
}

TEST(Simulator, GivesTheSameMeasurementsForTheSameSeedWithAnyNumberOfThreads) {
  const Rig rig = SmallRig(128);
  const Simulator first = MakeSimulator(rig, SmallOptions());
  const cv::Mat image = first.RenderImage(1, 2);
  const LidarScan scan = first.CastScan(1);
  const tbb::global_control one_thread(tbb::global_control::max_allowed_parallelism, 1);
  const Simulator second = MakeSimulator(rig, SmallOptions());
  EXPECT_TRUE(SamePixels(image, second.RenderImage(1, 2)));
  EXPECT_TRUE(SamePoints(scan, second.CastScan(1)));
  ASSERT_EQ(first.schedule().size(), second.schedule().size());
  for (std::size_t i = 0; i < first.schedule().size(); ++i) {
    EXPECT_EQ(first.schedule()[i].stamp_ns, second.schedule()[i].stamp_ns);
  }
  EXPECT_EQ(first.Imu(7).angular_velocity_rad_s, second.Imu(7).angular_velocity_rad_s);
  EXPECT_EQ(first.Odometry(7).odom_from_body.translation,
            second.Odometry(7).odom_from_body.translation);
}

TEST(Simulator, GivesAnotherRecordingForAnotherSeed) {
  const Rig rig = SmallRig(96);
  SimulationOptions options = SmallOptions();
  const Simulator first = MakeSimulator(rig, options);
  options.seed += 1;
  const Simulator second = MakeSimulator(rig, options);
  EXPECT_FALSE(SamePixels(first.RenderImage(0, 0), second.RenderImage(0, 0)));
  EXPECT_FALSE(SamePoints(first.CastScan(0), second.CastScan(0)));
  EXPECT_NE(first.num_triangles(), second.num_triangles());
}

TEST(Simulator, MakesEveryWorldAndDrive) {
  const Rig rig = SmallRig(64);
  for (const char* world : {"street", "suburb", "plaza", "industrial", "avenue", "village"}) {
    for (const char* drive : {"turns", "gentle", "straight"}) {
      SimulationOptions options = SmallOptions();
      options.world.kind = world;
      options.drive.kind = drive;
      options.duration_s = 0.4;
      const Simulator simulator = MakeSimulator(rig, options);
      const cv::Mat image = simulator.RenderImage(0, 0);
      cv::Scalar mean, stddev;
      cv::meanStdDev(image, mean, stddev);
      EXPECT_GT(stddev[0], 15.0) << world << " " << drive << ": an image without contrast";
      // Ground and walls all around: at least half of the rays come back.
      EXPECT_GT(simulator.CastScan(0).points.size(), 24U * 180U / 2U) << world << " " << drive;
    }
  }
}

/// Ring and range error of the returns of a scan that are not of the own vehicle, m.
std::vector<std::pair<std::uint16_t, double>> RangeErrors(const Simulator& simulator, int index) {
  const LidarScan scan = simulator.CastScan(index);
  std::vector<std::pair<std::uint16_t, double>> errors;
  for (const LidarPoint& point : scan.points) {
    const Timestamp stamp_ns = AddSeconds(scan.stamp_ns, point.time_offset_s);
    const Rigid3 map_from_lidar = *simulator.MapFromLidar(stamp_ns);
    const Eigen::Vector3d position = point.position_in_lidar_m.cast<double>();
    if (position.norm() < 4.0) continue;
    const auto truth = simulator.CastRay(stamp_ns, map_from_lidar.translation,
                                         map_from_lidar.rotation * position.normalized());
    if (truth) errors.emplace_back(point.ring, position.norm() - truth->range_m);
  }
  return errors;
}

TEST(Simulator, CastsLidarPointsOntoTheTrueSurfacesWithinTheirNoise) {
  SimulationOptions options = SmallOptions();
  options.lidar.range_noise_m = 0.02;
  const Simulator simulator = MakeSimulator(SmallRig(64), options);
  const auto errors = RangeErrors(simulator, 1);
  double sum2 = 0.0;
  int count = 0;
  for (const auto& [ring, error_m] : errors) {
    // A rounding of the direction may miss an edge; such rays say nothing about the noise.
    if (std::abs(error_m) > 0.2) continue;
    sum2 += error_m * error_m;
    ++count;
  }
  EXPECT_GT(count, static_cast<int>(errors.size()) / 2);
  EXPECT_NEAR(std::sqrt(sum2 / count), 0.02, 0.002);
}

TEST(Simulator, EveryLaserKeepsItsOwnRangeError) {
  SimulationOptions options = SmallOptions();
  options.lidar.range_noise_m = 0.002;
  options.lidar.ring_range_m = 0.03;
  const Simulator simulator = MakeSimulator(SmallRig(64), options);
  std::map<std::uint16_t, std::vector<double>> errors_of_ring[2];
  for (int scan = 0; scan < 2; ++scan) {
    for (const auto& [ring, error_m] : RangeErrors(simulator, scan)) {
      errors_of_ring[scan][ring].push_back(error_m);
    }
  }
  const auto median = [](std::vector<double> values) {
    std::nth_element(values.begin(), values.begin() + values.size() / 2, values.end());
    return values[values.size() / 2];
  };
  double sum2 = 0.0;
  int count = 0;
  for (const auto& [ring, errors_m] : errors_of_ring[0]) {
    const std::vector<double>& again_m = errors_of_ring[1][ring];
    if (errors_m.size() < 20 || again_m.size() < 20) continue;
    EXPECT_NEAR(median(errors_m), median(again_m), 0.002) << "ring " << ring;
    sum2 += median(errors_m) * median(errors_m);
    ++count;
  }
  ASSERT_GT(count, 8);
  EXPECT_NEAR(std::sqrt(sum2 / count), 0.03, 0.015);
}

TEST(Simulator, WideBeamsMeasureInBetweenAtEdges) {
  const auto count_between = [](double beam_mrad) {
    SimulationOptions options = SmallOptions();
    options.lidar.range_noise_m = 0.002;
    options.lidar.beam_mrad = beam_mrad;
    const Simulator simulator = MakeSimulator(SmallRig(64), options);
    const auto errors = RangeErrors(simulator, 1);
    return std::count_if(errors.begin(), errors.end(), [](const auto& error) {
      return std::abs(error.second) > 0.05 && std::abs(error.second) < 0.6;
    });
  };
  EXPECT_GT(count_between(4.0), count_between(0.0) + 20);
}

TEST(Simulator, SchedulesEverySensorInOrderWithinTheRecording) {
  Rig rig = SmallRig(64);
  rig.cameras[1].time_offset_s = 0.03;
  const SimulationOptions options = SmallOptions();
  const Simulator simulator = MakeSimulator(rig, options);
  Timestamp last = 0;
  int counts[4] = {0, 0, 0, 0};
  for (const ScheduledMeasurement& m : simulator.schedule()) {
    EXPECT_GE(m.arrival_ns, last);
    last = m.arrival_ns;
    ++counts[static_cast<int>(m.kind)];
    EXPECT_TRUE(simulator.true_map_from_lidar().Covers(m.exposure_ns));
    EXPECT_TRUE(simulator.true_map_from_lidar().Covers(m.arrival_ns));
    const double offset_s = m.kind == MeasurementKind::kImage && m.camera == 1 ? 0.03 : 0.0;
    EXPECT_NEAR(SecondsBetween(m.stamp_ns, m.exposure_ns), offset_s, 1e-9);
  }
  EXPECT_EQ(counts[0], simulator.num_scans());
  EXPECT_EQ(counts[1], simulator.num_images(0) + simulator.num_images(1));
  EXPECT_NEAR(counts[0], 10, 1);
  EXPECT_NEAR(counts[1], 20, 2);
  EXPECT_NEAR(counts[2], 200, 21);
  EXPECT_NEAR(counts[3], 50, 6);
}

/// An image shows what an earlier one did, at the pixels where the truth says.
void ExpectTruePixelsToShowTheSame(const Rig& rig) {
  SimulationOptions options = SmallOptions();
  options.camera.noise_levels = 0.0;
  options.world.num_moving_cars = 0;
  const Simulator simulator = MakeSimulator(rig, options);
  const int camera = 1;
  const Timestamp first_ns = ExposureOf(simulator, camera, 3);
  const Timestamp second_ns = AddSeconds(first_ns, 0.05);
  cv::Mat first, second;
  cv::cvtColor(simulator.RenderImageAt(camera, first_ns, 0), first, cv::COLOR_BGR2GRAY);
  cv::cvtColor(simulator.RenderImageAt(camera, second_ns, 0), second, cv::COLOR_BGR2GRAY);
  double at_projection = 0.0;
  double beside = 0.0;
  int count = 0;
  for (int y = 20; y < first.rows - 20; y += 3) {
    for (int x = 20; x < first.cols - 20; x += 3) {
      const auto point = simulator.TrueScenePoint(camera, first_ns, Eigen::Vector2d(x, y));
      if (!point || point->is_own_vehicle) continue;
      const auto pixel = simulator.TruePixel(camera, second_ns, point->point_in_map_m);
      if (!pixel || pixel->x() < 3.0 || pixel->y() < 3.0 || pixel->x() > first.cols - 4.0 ||
          pixel->y() > first.rows - 4.0) {
        continue;
      }
      const auto again = simulator.TrueScenePoint(camera, second_ns, *pixel);
      if (!again || (again->point_in_map_m - point->point_in_map_m).norm() > 0.05) continue;
      const auto level = [&second](double u, double v) {
        cv::Mat value;
        cv::getRectSubPix(second, cv::Size(1, 1),
                          cv::Point2f(static_cast<float>(u), static_cast<float>(v)), value);
        return static_cast<double>(value.at<std::uint8_t>(0, 0));
      };
      const double here = first.at<std::uint8_t>(y, x);
      at_projection += std::abs(level(pixel->x(), pixel->y()) - here);
      beside += std::abs(level(pixel->x() + 2.0, pixel->y() + 2.0) - here);
      ++count;
    }
  }
  ASSERT_GT(count, 2000);
  // What is left at the right place is interpolation and the change of scale.
  EXPECT_LT(at_projection / count, 5.0);
  EXPECT_GT(beside, 2.5 * at_projection);
}

TEST(Simulator, ShowsAScenePointWhereItsProjectionIsAtAnotherTime) {
  ExpectTruePixelsToShowTheSame(SmallRig(320));
}

TEST(Simulator, ExposesTheRowsOfARollingShutterOneAfterTheOther) {
  Rig rig = SmallRig(320);
  rig.cameras[1].rolling_shutter_line_time_s = 2e-4;
  ExpectTruePixelsToShowTheSame(rig);
  const Simulator rolling = MakeSimulator(rig, SmallOptions());
  const Simulator global = MakeSimulator(SmallRig(320), SmallOptions());
  const Timestamp stamp_ns = ExposureOf(rolling, 1, 3);
  EXPECT_EQ(rolling.RowTime(1, stamp_ns, 100.0), AddSeconds(stamp_ns, 0.02));
  EXPECT_EQ(global.RowTime(1, stamp_ns, 100.0), stamp_ns);
  const cv::Mat image = rolling.RenderImageAt(1, stamp_ns, 0);
  const cv::Mat at_once = global.RenderImageAt(1, stamp_ns, 0);
  const cv::Mat later = global.RenderImageAt(1, rolling.RowTime(1, stamp_ns, image.rows - 1), 0);
  // The exposure breathes: the last row, 40 ms later, may be a level brighter or darker.
  const int last = image.rows - 1;
  EXPECT_EQ(cv::norm(image.row(0), at_once.row(0), cv::NORM_INF), 0.0);
  EXPECT_LE(cv::norm(image.row(last), later.row(last), cv::NORM_INF), 2.0);
  EXPECT_GT(cv::norm(image.row(last), at_once.row(last), cv::NORM_INF), 20.0);
}

TEST(Simulator, DrawsAThousandCornersThatAreNotNoise) {
  SimulationOptions options = SmallOptions();
  options.camera.noise_levels = 0.0;
  options.camera.color = false;
  const Simulator simulator = MakeSimulator(SmallRig(960), options);
  const cv::Mat image = simulator.RenderImage(0, 0);
  ASSERT_EQ(image.type(), CV_8UC1);
  std::vector<cv::Point2f> corners;
  cv::goodFeaturesToTrack(image, corners, 3000, 0.01, 7.0);
  EXPECT_GE(corners.size(), 1000U);
  // In every part of the road and of the buildings, not in one loud place.
  int filled = 0;
  for (int row = 1; row < 5; ++row) {
    for (int column = 0; column < 8; ++column) {
      const cv::Rect2f cell(120.0F * column, 120.0F * row, 120.0F, 120.0F);
      filled += std::any_of(corners.begin(), corners.end(),
                            [&cell](const cv::Point2f& p) { return cell.contains(p); })
                    ? 1
                    : 0;
    }
  }
  EXPECT_GE(filled, 28);
}

TEST(Simulator, CarriesPointsOfMovingCarsAlong) {
  SimulationOptions options = SmallOptions();
  options.drive.kind = "straight";
  const Simulator simulator = MakeSimulator(SmallRig(320), options);
  const Timestamp now_ns = ExposureOf(simulator, 0, 1);
  const Timestamp later_ns = AddSeconds(now_ns, 0.3);
  int moving = 0;
  for (int y = 60; y < 160; y += 2) {
    for (int x = 0; x < 320; x += 2) {
      const auto point = simulator.TrueScenePoint(0, now_ns, Eigen::Vector2d(x, y));
      if (!point) continue;
      const auto later = simulator.PointAtTime(*point, now_ns, later_ns);
      ASSERT_TRUE(later.has_value());
      const double moved_m = (*later - point->point_in_map_m).norm();
      if (point->is_moving) {
        ++moving;
        EXPECT_GT(moved_m, 0.5);
        EXPECT_LT(moved_m, 5.0);
      } else if (!point->is_own_vehicle) {
        EXPECT_EQ(moved_m, 0.0);
      }
    }
  }
  EXPECT_GT(moving, 10) << "no moving car in view";
}

TEST(Simulator, PerturbsTheRigByBetweenHalfAndAllOfTheOptions) {
  SimulationOptions options = SmallOptions();
  options.start.time_offset_s = 0.01;
  const Simulator simulator = MakeSimulator(SmallRig(320), options);
  const Result<Rig> start = simulator.PerturbedRig();
  ASSERT_TRUE(start.ok()) << start.status().message();
  for (std::size_t i = 0; i < start->cameras.size(); ++i) {
    const CameraConfig& truth = simulator.true_rig().cameras[i];
    const CameraConfig& off = start->cameras[i];
    const Rigid3 error = truth.lidar_from_camera.Inverse() * off.lidar_from_camera;
    const Eigen::Vector3d rotation_deg = LogSo3(error.rotation) * 180.0 / M_PI;
    const Eigen::Vector2d centre_px =
        off.model->tunable().principal_point_px - truth.model->tunable().principal_point_px;
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_GE(std::abs(rotation_deg[axis]), 0.25 - 1e-9);
      EXPECT_LE(std::abs(rotation_deg[axis]), 0.5 + 1e-9);
      EXPECT_GE(std::abs(error.translation[axis]), 0.025 - 1e-9);
      EXPECT_LE(std::abs(error.translation[axis]), 0.05 + 1e-9);
    }
    for (int axis = 0; axis < 2; ++axis) {
      EXPECT_GE(std::abs(centre_px[axis]), 2.0 - 1e-9);
      EXPECT_LE(std::abs(centre_px[axis]), 4.0 + 1e-9);
    }
    const double offset_s = std::abs(off.time_offset_s - truth.time_offset_s);
    EXPECT_GE(offset_s, 0.005 - 1e-12);
    EXPECT_LE(offset_s, 0.01 + 1e-12);
  }
}

TEST(Simulator, LeavesPixelsBeyondTheImageCircleBlack) {
  Rig rig = *DefaultRig();
  rig.cameras.erase(rig.cameras.begin(), rig.cameras.begin() + 2);
  SimulationOptions options = SmallOptions();
  options.camera.noise_levels = 0.0;
  options.camera.supersampling = 1;
  const Simulator simulator = MakeSimulator(rig, options);
  const cv::Mat image = simulator.RenderImage(0, 0);
  EXPECT_EQ(image.at<cv::Vec3b>(0, 0), cv::Vec3b(0, 0, 0));
  EXPECT_NE(image.at<cv::Vec3b>(360, 640), cv::Vec3b(0, 0, 0));
  EXPECT_FALSE(simulator.TrueScenePoint(0, ExposureOf(simulator, 0, 0), Eigen::Vector2d(0.0, 0.0)));
}

TEST(Simulator, TakesARigWithoutImuAndOdometry) {
  Rig rig = SmallRig(64);
  rig.imu.reset();
  rig.odometry.reset();
  const Simulator simulator = MakeSimulator(rig, SmallOptions());
  for (const ScheduledMeasurement& m : simulator.schedule()) {
    EXPECT_TRUE(m.kind == MeasurementKind::kScan || m.kind == MeasurementKind::kImage);
  }
  // Nothing says where the ground is but the option: straight down it is the lidar's height away.
  const Timestamp start_ns = simulator.true_map_from_lidar().start_ns();
  const auto ground =
      simulator.CastRay(start_ns, simulator.MapFromLidar(start_ns)->translation, {0.0, 0.0, -1.0});
  ASSERT_TRUE(ground.has_value());
  EXPECT_NEAR(ground->range_m, SmallOptions().lidar.height_m, 0.15);
}

TEST(Simulator, RefusesACameraWithoutIntrinsicsByName) {
  Rig rig = SmallRig(64);
  rig.cameras[1].model = nullptr;
  const Result<Simulator> simulator = Simulator::Create(rig, SmallOptions());
  ASSERT_FALSE(simulator.ok());
  EXPECT_NE(simulator.status().message().find("'left'"), std::string::npos);
}

TEST(Simulator, RefusesOptionsOutOfBoundsAndUnknownKinds) {
  const Rig rig = SmallRig(64);
  const auto message_of = [&rig](const SimulationOptions& options) {
    const Result<Simulator> simulator = Simulator::Create(rig, options);
    EXPECT_FALSE(simulator.ok());
    return simulator.status().message();
  };
  SimulationOptions options = SmallOptions();
  options.duration_s = 0.0;
  EXPECT_NE(message_of(options).find("duration_s"), std::string::npos);
  options = SmallOptions();
  options.world.kind = "moon";
  EXPECT_NE(message_of(options).find("moon"), std::string::npos);
  options = SmallOptions();
  options.drive.kind = "rally";
  EXPECT_NE(message_of(options).find("rally"), std::string::npos);
  options = SmallOptions();
  options.lidar.lowest_ring_deg = 20.0;
  EXPECT_NE(message_of(options).find("lowest_ring_deg"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
