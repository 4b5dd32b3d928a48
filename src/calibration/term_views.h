#pragma once

#include <unordered_map>
#include <vector>

#include "scenecalib/calibration/calibration_problem.h"
#include "scenecalib/calibration/trajectory_correction.h"
#include "scenecalib/calibration/transfer_error.h"

namespace scenecalib {

/// What terms between two views share: the image's time and place.
struct TermView {
  int camera = 0;
  TransferView view;  ///< its pixel is not used
  TrajectoryCorrection::Place place;
};

/// Where a ray starts.
struct SourcePixel {
  int camera = 0;
  Eigen::Vector2d pixel;

  bool operator==(const SourcePixel& other) const {
    return camera == other.camera && pixel == other.pixel;
  }
};
/// Index of a term's ray, which is appended where it differs from the last one.
int IndexOfRay(const TransferTerm& term, std::vector<SourcePixel>* rays);
std::vector<SourceRay> RaysOf(const std::vector<SourcePixel>& pixels,
                              const std::vector<CameraParameters>& cameras, bool with_derivatives);

/// Finds the views of terms again.
class ViewIndex {
 public:
  /// Appends to `views` what it did not see before.
  explicit ViewIndex(std::vector<TermView>* views) : views_(*views) {}

  int IndexOf(int camera, const TransferView& view, const TrajectoryCorrection::Place& place);

 private:
  std::vector<TermView>& views_;
  std::unordered_map<std::size_t, std::vector<int>> by_hash_;
};

/// The views of some terms, so that the pose of each is computed once for all its terms.
class TermViews {
 public:
  /// `terms` must outlive this and stay as they are.
  explicit TermViews(const std::vector<TransferTerm>& terms);

  /// Of all views, for Evaluate.
  std::vector<ViewPose> PosesAt(const std::vector<CameraParameters>& cameras,
                                const TrajectoryCorrection& correction) const;

  /// Of all terms, which mostly start from the same pixel as the term before, for Evaluate.
  std::vector<SourceRay> RaysAt(const std::vector<CameraParameters>& cameras,
                                bool with_derivatives) const;

  /// EvaluateTransfer of a term; false where it cannot be evaluated. `jacobians` may be null.
  bool Evaluate(std::size_t term, const std::vector<CameraParameters>& cameras,
                const std::vector<ViewPose>& poses, const std::vector<SourceRay>& rays,
                Eigen::Vector2d* residual_px, PoseJacobians* jacobians) const;

 private:
  struct Ends {
    int source = 0;
    int target = 0;
    int ray = 0;
  };
  const std::vector<TransferTerm>& terms_;
  std::vector<TermView> views_;
  std::vector<Ends> ends_;         ///< indices into views_ and of the ray, by term
  std::vector<SourcePixel> rays_;  ///< that differ
};

}  // namespace scenecalib
