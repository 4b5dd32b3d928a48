#include "scenecalib/sensor/point_cloud_decoder.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

namespace scenecalib {
namespace {

constexpr std::uint8_t kUint8 = 2, kUint16 = 4, kUint32 = 6, kFloat32 = 7, kFloat64 = 8;
constexpr Timestamp kStampNs = 1700000000123456789;

/// A cloud under construction, every byte of it.
struct Cloud {
  PointCloudView view;
  std::vector<std::uint8_t> bytes;

  Cloud(std::vector<PointCloudField> fields, std::uint32_t step, std::uint32_t width,
        std::uint32_t height = 1, std::uint32_t row_padding = 0) {
    view.stamp_ns = kStampNs;
    view.fields = std::move(fields);
    view.point_step = step;
    view.width = width;
    view.height = height;
    view.row_step = width * step + row_padding;
    bytes.assign(static_cast<std::size_t>(view.row_step) * height, 0xAB);
  }
  template <typename T>
  void Set(std::uint32_t index, const std::string& name, T value) {
    for (const PointCloudField& field : view.fields) {
      if (field.name != name) continue;
      std::uint8_t raw[sizeof(T)];
      std::memcpy(raw, &value, sizeof(T));
      if (view.is_bigendian) std::reverse(raw, raw + sizeof(T));
      std::memcpy(bytes.data() + (index / view.width) * view.row_step +
                      (index % view.width) * view.point_step + field.offset,
                  raw, sizeof(T));
    }
  }
  void SetXyz(std::uint32_t index, float x, float y, float z) {
    Set(index, "x", x);
    Set(index, "y", y);
    Set(index, "z", z);
  }
  Result<LidarScan> Decode(const LidarConfig& config = {}) {
    view.data = bytes.data();
    view.size = bytes.size();
    return DecodePointCloud(view, config);
  }
};

std::vector<PointCloudField> Xyz() {
  return {{"x", 0, kFloat32, 1}, {"y", 4, kFloat32, 1}, {"z", 8, kFloat32, 1}};
}

std::vector<PointCloudField> XyzAnd(const PointCloudField& field) {
  auto fields = Xyz();
  fields.push_back(field);
  return fields;
}

TEST(PointCloudDecoder, ReadsTimeInFloatSeconds) {
  Cloud cloud(XyzAnd({"time", 12, kFloat32, 1}), 16, 2);
  cloud.SetXyz(0, 1, 2, 3);
  cloud.SetXyz(1, 4, 5, 6);
  cloud.Set(0, "time", -0.05F);
  cloud.Set(1, "time", 0.025F);
  const auto scan = cloud.Decode();
  ASSERT_TRUE(scan.ok()) << scan.status().message();
  ASSERT_EQ(scan->points.size(), 2U);
  EXPECT_EQ(scan->stamp_ns, kStampNs);
  EXPECT_EQ(scan->points[1].position_in_lidar_m, Eigen::Vector3f(4, 5, 6));
  EXPECT_FLOAT_EQ(scan->points[0].time_offset_s, -0.05F);
  EXPECT_FLOAT_EQ(scan->points[1].time_offset_s, 0.025F);
}

TEST(PointCloudDecoder, ReadsIntegerNanoseconds) {
  for (const char* name : {"t", "offset_time"}) {
    Cloud cloud(XyzAnd({name, 12, kUint32, 1}), 16, 1);
    cloud.SetXyz(0, 1, 2, 3);
    cloud.Set(0, name, std::uint32_t{50000000});
    const auto scan = cloud.Decode();
    ASSERT_TRUE(scan.ok()) << scan.status().message();
    EXPECT_FLOAT_EQ(scan->points[0].time_offset_s, 0.05F) << name;
  }
}

TEST(PointCloudDecoder, ReadsTimestampAbsoluteRelativeAndInNanoseconds) {
  const double offset_s = 0.0371;
  const double kDoublePrecisionS = 3e-7;  // of seconds since 1970 in a double
  for (const double value :
       {offset_s, 1700000000.123456789 + offset_s, 1700000000123456789.0 + 1e9 * offset_s}) {
    Cloud cloud(XyzAnd({"timestamp", 16, kFloat64, 1}), 24, 1);
    cloud.SetXyz(0, 1, 2, 3);
    cloud.Set(0, "timestamp", value);
    const auto scan = cloud.Decode();
    ASSERT_TRUE(scan.ok()) << scan.status().message();
    EXPECT_NEAR(scan->points[0].time_offset_s, offset_s, kDoublePrecisionS) << value;
  }
}

TEST(PointCloudDecoder, FollowsAnyFieldOrderTypeAndPadding) {
  Cloud cloud({{"ring", 1, kUint16, 1},
               {"z", 5, kFloat64, 1},
               {"intensity", 0, kUint8, 1},
               {"x", 20, kFloat64, 1},
               {"t", 13, kUint32, 1},
               {"y", 30, kFloat64, 1}},
              45, 3, 2, 7);
  for (std::uint32_t i = 0; i < 6; ++i) {
    cloud.Set(i, "x", 1.0 + i);
    cloud.Set(i, "y", 2.0 + i);
    cloud.Set(i, "z", 3.0 + i);
    cloud.Set(i, "intensity", static_cast<std::uint8_t>(10 * i));
    cloud.Set(i, "ring", static_cast<std::uint16_t>(7 + i));
    cloud.Set(i, "t", std::uint32_t{1000000} * i);
  }
  const auto scan = cloud.Decode();
  ASSERT_TRUE(scan.ok()) << scan.status().message();
  ASSERT_EQ(scan->points.size(), 6U);
  EXPECT_EQ(scan->points[4].position_in_lidar_m, Eigen::Vector3f(5, 6, 7));
  EXPECT_EQ(scan->points[4].ring, 11);
  EXPECT_FLOAT_EQ(scan->points[4].intensity, 40.0F);
  EXPECT_FLOAT_EQ(scan->points[4].time_offset_s, 0.004F);
}

TEST(PointCloudDecoder, ReadsBigEndian) {
  Cloud cloud(XyzAnd({"t", 12, kUint32, 1}), 16, 1);
  cloud.view.is_bigendian = true;
  cloud.SetXyz(0, 1.5F, -2.5F, 3.25F);
  cloud.Set(0, "t", std::uint32_t{10000000});
  const auto scan = cloud.Decode();
  ASSERT_TRUE(scan.ok()) << scan.status().message();
  EXPECT_EQ(scan->points[0].position_in_lidar_m, Eigen::Vector3f(1.5F, -2.5F, 3.25F));
  EXPECT_FLOAT_EQ(scan->points[0].time_offset_s, 0.01F);
}

TEST(PointCloudDecoder, DropsPointsThatAreNotFiniteOrAtTheOrigin) {
  Cloud cloud(XyzAnd({"time", 12, kFloat32, 1}), 16, 4, 1);
  const float nan = std::numeric_limits<float>::quiet_NaN();
  cloud.SetXyz(0, nan, 2, 3);
  cloud.SetXyz(1, 0, 0, 0);
  cloud.SetXyz(2, 1, 2, 3);
  cloud.SetXyz(3, 1, 2, 3);
  for (std::uint32_t i = 0; i < 4; ++i) cloud.Set(i, "time", i == 3 ? nan : 0.0F);
  const auto scan = cloud.Decode();
  ASSERT_TRUE(scan.ok()) << scan.status().message();
  EXPECT_EQ(scan->points.size(), 1U);
}

TEST(PointCloudDecoder, PutsEveryPointAtTheStampWhenMotionIsCompensated) {
  Cloud cloud(XyzAnd({"time", 12, kFloat32, 1}), 16, 1);
  cloud.SetXyz(0, 1, 2, 3);
  cloud.Set(0, "time", 0.05F);
  LidarConfig config;
  config.motion_compensated = true;
  EXPECT_FLOAT_EQ(cloud.Decode(config)->points[0].time_offset_s, 0.0F);
}

/// A sweep of `num_columns` columns and `num_rings` rings turning in `direction`, stored ring by
/// ring or column by column; returns the largest error of the decoded times.
double AzimuthTimeError(double direction, bool ring_by_ring, bool with_ring_field) {
  const std::uint32_t num_columns = 360, num_rings = 4;
  auto fields = Xyz();
  if (with_ring_field) fields.push_back({"ring", 12, kUint16, 1});
  Cloud cloud(fields, 16, num_columns * num_rings);
  std::vector<double> expected;
  for (std::uint32_t i = 0; i < num_columns * num_rings; ++i) {
    const std::uint32_t column = ring_by_ring ? i % num_columns : i / num_rings;
    const std::uint32_t ring = ring_by_ring ? i / num_columns : i % num_rings;
    const double share = column / static_cast<double>(num_columns);
    const double azimuth = 1.0 + direction * 6.283185307179586 * share;
    cloud.SetXyz(i, static_cast<float>(10.0 * std::cos(azimuth)),
                 static_cast<float>(10.0 * std::sin(azimuth)), static_cast<float>(ring));
    if (with_ring_field) cloud.Set(i, "ring", static_cast<std::uint16_t>(ring));
    expected.push_back(0.1 * share);
  }
  LidarConfig config;
  config.scan_period_s = 0.1;
  const auto scan = cloud.Decode(config);
  if (!scan.ok() || scan->points.size() != expected.size()) return 1.0;
  double error_s = 0.0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    // A share that rounds to just below zero may appear as a whole turn: the same direction.
    const double difference_s = std::abs(scan->points[i].time_offset_s - expected[i]);
    error_s = std::max(error_s, std::min(difference_s, std::abs(difference_s - 0.1)));
  }
  return error_s;
}

TEST(PointCloudDecoder, RebuildsTimesFromAzimuthInBothDirectionsAndOrders) {
  for (const double direction : {-1.0, 1.0}) {
    for (const bool ring_by_ring : {false, true}) {
      for (const bool with_ring_field : {false, true}) {
        EXPECT_LT(AzimuthTimeError(direction, ring_by_ring, with_ring_field), 1e-5)
            << direction << ring_by_ring << with_ring_field;
      }
    }
  }
}

TEST(PointCloudDecoder, SaysWhichTimeIsMissing) {
  Cloud cloud(Xyz(), 12, 1);
  cloud.SetXyz(0, 1, 2, 3);
  LidarConfig config;
  config.topic = "/points";
  const auto scan = cloud.Decode(config);
  ASSERT_FALSE(scan.ok());
  EXPECT_EQ(scan.status().code(), Status::Code::kInvalidArgument);
  EXPECT_NE(scan.status().message().find("/points"), std::string::npos);
  EXPECT_NE(scan.status().message().find("scan_period_s"), std::string::npos);
}

TEST(PointCloudDecoder, SaysWhichCoordinateIsMissing) {
  Cloud cloud({{"x", 0, kFloat32, 1}, {"y", 4, kFloat32, 1}}, 12, 1);
  const auto scan = cloud.Decode();
  ASSERT_FALSE(scan.ok());
  EXPECT_NE(scan.status().message().find("'z'"), std::string::npos);
}

TEST(PointCloudDecoder, RefusesBytesThatAreCutShort) {
  Cloud cloud(XyzAnd({"time", 12, kFloat32, 1}), 16, 4);
  cloud.bytes.resize(40);
  EXPECT_EQ(cloud.Decode().status().code(), Status::Code::kInvalidArgument);
}

TEST(PointCloudDecoder, RefusesFieldsBeyondThePointStepAndUnknownTypes) {
  Cloud beyond(XyzAnd({"time", 14, kFloat32, 1}), 16, 1);
  EXPECT_NE(beyond.Decode().status().message().find("'time'"), std::string::npos);
  Cloud unknown(XyzAnd({"time", 12, 9, 1}), 16, 1);
  EXPECT_NE(unknown.Decode().status().message().find("datatype"), std::string::npos);
  Cloud rows(XyzAnd({"time", 12, kFloat32, 1}), 16, 2, 2);
  rows.view.row_step = 16;
  EXPECT_NE(rows.Decode().status().message().find("row step"), std::string::npos);
}

TEST(PointCloudDecoder, RefusesPointsOnAnotherClock) {
  Cloud cloud(XyzAnd({"timestamp", 16, kFloat64, 1}), 24, 1);
  cloud.SetXyz(0, 1, 2, 3);
  cloud.Set(0, "timestamp", 1600000000.0);
  const auto scan = cloud.Decode();
  ASSERT_FALSE(scan.ok());
  EXPECT_NE(scan.status().message().find("clock"), std::string::npos);
}

TEST(PointCloudDecoder, ReportsACloudWithoutValidPoints) {
  Cloud cloud(XyzAnd({"time", 12, kFloat32, 1}), 16, 1);
  cloud.SetXyz(0, std::numeric_limits<float>::quiet_NaN(), 0, 0);
  cloud.Set(0, "time", 0.0F);
  EXPECT_EQ(cloud.Decode().status().code(), Status::Code::kInsufficientData);
  Cloud empty(XyzAnd({"time", 12, kFloat32, 1}), 16, 0);
  EXPECT_EQ(empty.Decode().status().code(), Status::Code::kInsufficientData);
}

}  // namespace
}  // namespace scenecalib
