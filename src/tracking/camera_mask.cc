#include "scenecalib/tracking/camera_mask.h"

#include <opencv2/imgcodecs.hpp>
#include <string>

namespace scenecalib {

Result<cv::Mat> ReadCameraMask(const CameraConfig& camera) {
  if (!camera.mask_file) return cv::Mat();
  const std::string what = "camera " + camera.name + ": mask " + *camera.mask_file;
  const cv::Mat image = cv::imread(*camera.mask_file, cv::IMREAD_GRAYSCALE);
  if (image.empty()) return Status::NotFound(what + " cannot be read as an image");
  if (camera.model &&
      (image.cols != camera.model->width_px() || image.rows != camera.model->height_px())) {
    return Status::InvalidArgument(what + " is " + std::to_string(image.cols) + "x" +
                                   std::to_string(image.rows) + ", must be " +
                                   std::to_string(camera.model->width_px()) + "x" +
                                   std::to_string(camera.model->height_px()) + " as the images");
  }
  const cv::Mat mask = image > 0;
  if (cv::countNonZero(mask) == 0) {
    return Status::InvalidArgument(what + " is black everywhere: nothing is left to track");
  }
  return mask;
}

}  // namespace scenecalib
