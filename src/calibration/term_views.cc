#include "term_views.h"

#include <functional>

namespace scenecalib {
namespace {

std::size_t Hash(int camera, const TransferView& view) {
  auto hash = static_cast<std::size_t>(camera);
  for (int k = 0; k < 3; ++k) {
    hash = hash * 1000003U ^ std::hash<double>()(view.map_from_lidar.translation[k]);
  }
  return hash;
}

}  // namespace

int IndexOfRay(const TransferTerm& term, std::vector<SourcePixel>* rays) {
  const SourcePixel here{term.source_camera, term.source.pixel};
  if (rays->empty() || !(rays->back() == here)) rays->push_back(here);
  return static_cast<int>(rays->size()) - 1;
}

std::vector<SourceRay> RaysOf(const std::vector<SourcePixel>& pixels,
                              const std::vector<CameraParameters>& cameras, bool with_derivatives) {
  std::vector<SourceRay> rays;
  rays.reserve(pixels.size());
  for (const SourcePixel& pixel : pixels) {
    rays.push_back(
        RayOf(cameras[static_cast<std::size_t>(pixel.camera)], pixel.pixel, with_derivatives));
  }
  return rays;
}

int ViewIndex::IndexOf(int camera, const TransferView& view,
                       const TrajectoryCorrection::Place& place) {
  std::vector<int>& candidates = by_hash_[Hash(camera, view)];
  for (const int i : candidates) {
    const TermView& other = views_[static_cast<std::size_t>(i)];
    if (other.camera == camera && other.place.index == place.index &&
        other.place.fraction == place.fraction &&
        other.view.map_from_lidar.translation == view.map_from_lidar.translation &&
        other.view.map_from_lidar.rotation.coeffs() == view.map_from_lidar.rotation.coeffs() &&
        other.view.twist_in_lidar == view.twist_in_lidar) {
      return i;
    }
  }
  candidates.push_back(static_cast<int>(views_.size()));
  views_.push_back({camera, view, place});
  return candidates.back();
}

TermViews::TermViews(const std::vector<TransferTerm>& terms) : terms_(terms) {
  ViewIndex index(&views_);
  ends_.reserve(terms.size());
  for (const TransferTerm& term : terms) {
    ends_.push_back({index.IndexOf(term.source_camera, term.source, term.source_place),
                     index.IndexOf(term.target_camera, term.target, term.target_place),
                     IndexOfRay(term, &rays_)});
  }
}

std::vector<SourceRay> TermViews::RaysAt(const std::vector<CameraParameters>& cameras,
                                         bool with_derivatives) const {
  return RaysOf(rays_, cameras, with_derivatives);
}

std::vector<ViewPose> TermViews::PosesAt(const std::vector<CameraParameters>& cameras,
                                         const TrajectoryCorrection& correction) const {
  std::vector<ViewPose> poses;
  poses.reserve(views_.size());
  for (const TermView& view : views_) {
    poses.push_back(PoseOf(view.view, cameras[static_cast<std::size_t>(view.camera)],
                           correction.At(view.place)));
  }
  return poses;
}

bool TermViews::Evaluate(std::size_t term, const std::vector<CameraParameters>& cameras,
                         const std::vector<ViewPose>& poses, const std::vector<SourceRay>& rays,
                         Eigen::Vector2d* residual_px, PoseJacobians* jacobians) const {
  const TransferTerm& t = terms_[term];
  const Ends& ends = ends_[term];
  return EvaluatePosedTransfer(rays[static_cast<std::size_t>(ends.ray)],
                               poses[static_cast<std::size_t>(ends.source)], t.target.pixel,
                               cameras[static_cast<std::size_t>(t.target_camera)],
                               poses[static_cast<std::size_t>(ends.target)], t.plane_point_in_map_m,
                               t.plane_normal_in_map, residual_px, jacobians);
}

}  // namespace scenecalib
