#include "scenecalib/ros/image_conversion.h"

#include <cv_bridge/cv_bridge.h>
#include <sensor_msgs/image_encodings.h>

#include <algorithm>
#include <cmath>
#include <exception>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <string>
#include <vector>

#include "scenecalib/sensor/camera_factory.h"

namespace scenecalib {
namespace {

namespace encodings = sensor_msgs::image_encodings;

constexpr double kColourPeriod_s =
    0.9;  // a little below a second, for images that come once in one

Timestamp Nanoseconds(const ros::Time& time) { return static_cast<Timestamp>(time.toNSec()); }

/// cv_bridge trusts the sizes that the message states.
Status CheckLayout(const sensor_msgs::Image& message) {
  const std::string size = std::to_string(message.width) + " x " + std::to_string(message.height);
  if (message.width == 0 || message.height == 0) {
    return Status::InvalidArgument("image of " + size + " pixels");
  }
  const bool is_yuv = message.encoding == encodings::YUV422 || message.encoding == "yuv422_yuy2";
  int bytes_per_pixel = 2;
  if (!is_yuv) {
    try {
      bytes_per_pixel =
          encodings::numChannels(message.encoding) * encodings::bitDepth(message.encoding) / 8;
    } catch (const std::exception&) {
      return Status::InvalidArgument("unknown image encoding \"" + message.encoding + "\"");
    }
  }
  const std::uint64_t row = static_cast<std::uint64_t>(message.width) * bytes_per_pixel;
  const std::uint64_t needed = static_cast<std::uint64_t>(message.step) * message.height;
  if (message.step < row || message.data.size() < needed) {
    return Status::InvalidArgument("image of " + size + " pixels, " + message.encoding + ", step " +
                                   std::to_string(message.step) + " has only " +
                                   std::to_string(message.data.size()) + " bytes");
  }
  return Status::Ok();
}

/// Significant bits of the largest value: 8, 10, 12, 14 or 16.
int SignificantBits(const cv::Mat& mono16) {
  double max = 0.0;
  cv::minMaxLoc(mono16, nullptr, &max);
  int bits = 8;
  while (bits < 16 && max >= static_cast<double>(1 << bits)) bits += 2;
  return bits;
}

cv::Mat LumaOfYuv422(const sensor_msgs::Image& message) {
  const cv::Mat interleaved(static_cast<int>(message.height), static_cast<int>(message.width),
                            CV_8UC2, const_cast<std::uint8_t*>(message.data.data()), message.step);
  cv::Mat luma;
  cv::extractChannel(interleaved, luma, message.encoding == encodings::YUV422 ? 1 : 0);
  return luma;
}

}  // namespace

bool ImageConverter::WantsColour(Timestamp stamp_ns) {
  if (last_colour_ns_ && std::abs(SecondsBetween(*last_colour_ns_, stamp_ns)) < kColourPeriod_s) {
    return false;
  }
  last_colour_ns_ = stamp_ns;
  return true;
}

Result<GrayImage> ImageConverter::Convert(const sensor_msgs::Image& message) {
  SCENECALIB_RETURN_IF_ERROR(CheckLayout(message));
  GrayImage gray;
  gray.stamp_ns = Nanoseconds(message.header.stamp);
  try {
    if (message.encoding == encodings::YUV422 || message.encoding == "yuv422_yuy2") {
      gray.pixels = LumaOfYuv422(message);
    } else if (message.encoding == encodings::MONO16 || message.encoding == encodings::TYPE_16UC1) {
      sensor_msgs::Image as_mono16 = message;
      as_mono16.encoding = encodings::MONO16;
      const cv::Mat deep = cv_bridge::toCvCopy(as_mono16, encodings::MONO16)->image;
      mono16_bits_ = std::max(mono16_bits_, SignificantBits(deep));
      deep.convertTo(gray.pixels, CV_8U, 255.0 / ((1 << mono16_bits_) - 1));
    } else if (message.encoding == encodings::TYPE_8UC1) {
      sensor_msgs::Image as_mono8 = message;
      as_mono8.encoding = encodings::MONO8;
      gray.pixels = cv_bridge::toCvCopy(as_mono8, encodings::MONO8)->image;
    } else {
      gray.pixels = cv_bridge::toCvCopy(message, encodings::MONO8)->image;
      if (message.encoding != encodings::MONO8 && WantsColour(gray.stamp_ns)) {
        gray.colour = cv_bridge::toCvCopy(message, encodings::BGR8)->image;
      }
    }
  } catch (const std::exception& error) {
    return Status::InvalidArgument("image encoding \"" + message.encoding +
                                   "\" cannot be converted to grey: " + error.what());
  }
  return gray;
}

Result<GrayImage> ImageConverter::Convert(const sensor_msgs::CompressedImage& message) {
  GrayImage gray;
  gray.stamp_ns = Nanoseconds(message.header.stamp);
  try {
    if (!message.data.empty()) {
      gray.pixels =
          cv::imdecode(message.data, cv::IMREAD_GRAYSCALE | cv::IMREAD_IGNORE_ORIENTATION);
      if (!gray.pixels.empty() && WantsColour(gray.stamp_ns)) {
        gray.colour = cv::imdecode(message.data, cv::IMREAD_COLOR | cv::IMREAD_IGNORE_ORIENTATION);
      }
    }
  } catch (const std::exception&) {
    gray.pixels.release();
  }
  if (gray.pixels.empty()) {
    return Status::InvalidArgument("compressed image (\"" + message.format + "\", " +
                                   std::to_string(message.data.size()) +
                                   " bytes) is neither JPEG nor PNG, or is damaged");
  }
  return gray;
}

Result<CameraModelPtr> CameraModelFromInfo(const sensor_msgs::CameraInfo& info) {
  if (info.K[0] <= 0.0 || info.K[4] <= 0.0) {
    return Status::InvalidArgument(
        "camera_info has no focal length (K is zero): the camera is uncalibrated, give its "
        "intrinsics in the rig file");
  }
  std::string model = info.distortion_model;
  if (model == "fisheye") model = "equidistant";
  if (model.empty() && info.D.empty()) model = "plumb_bob";
  // K is of the full sensor; the image is its region of interest, binned. With pixel centres at
  // integers, the centre of a binned pixel lies (binning - 1) / 2 into its first pixel.
  const double bin_x = std::max(1U, info.binning_x);
  const double bin_y = std::max(1U, info.binning_y);
  const bool has_roi = info.roi.width > 0 && info.roi.height > 0;
  const double width = has_roi ? info.roi.width : info.width;
  const double height = has_roi ? info.roi.height : info.height;
  CameraIntrinsics intrinsics;
  intrinsics.model = model;
  intrinsics.width_px = static_cast<int>(width / bin_x);
  intrinsics.height_px = static_cast<int>(height / bin_y);
  intrinsics.focal_px = {info.K[0] / bin_x, info.K[4] / bin_y};
  intrinsics.principal_point_px = {(info.K[2] - info.roi.x_offset - 0.5 * (bin_x - 1.0)) / bin_x,
                                   (info.K[5] - info.roi.y_offset - 0.5 * (bin_y - 1.0)) / bin_y};
  intrinsics.distortion.assign(info.D.begin(), info.D.end());
  if (intrinsics.distortion.empty()) {
    intrinsics.distortion.assign(model == "equidistant" ? 4 : 5, 0.0);
  }
  return CreateCameraModel(intrinsics);
}

}  // namespace scenecalib
