#include "scenecalib/tracking/static_regions.h"

#include <algorithm>
#include <cmath>
#include <opencv2/imgproc.hpp>

namespace scenecalib {
namespace {

/// Edge of a tile, pixels of the reduced image.
constexpr int kTilePx = 8;
/// The scene's motion is asked for once for so many tiles, squared.
constexpr int kTilesPerCell = 4;
/// Of OpenCV's derivatives (Scharr) to grey levels a pixel.
constexpr float kPerLevel = 1.0F / 32.0F;
/// Means forget what is older than this many looks.
constexpr int kMemory = 24;
/// Static tiles next to fewer others than this are not believed.
constexpr int kMinCluster = 3;

/// Drops static tiles that have too few of their kind around them.
void KeepClusters(cv::Mat1b* is_static) {
  cv::Mat labels;
  cv::Mat statistics;
  cv::Mat centroids;
  const int count = cv::connectedComponentsWithStats(*is_static, labels, statistics, centroids, 8);
  for (int label = 1; label < count; ++label) {
    if (statistics.at<int>(label, cv::CC_STAT_AREA) < kMinCluster) {
      is_static->setTo(0, labels == label);
    }
  }
}

/// Adds empty tiles that only static ones, or nothing that is seen at all, surround.
void FillEnclosed(const cv::Mat1b& is_empty, const std::vector<char>& is_seen,
                  cv::Mat1b* is_static) {
  cv::Mat1i labels;
  const int count = cv::connectedComponents(is_empty, labels, 4);
  std::vector<char> is_open(static_cast<std::size_t>(count), 0);
  std::vector<char> touches_static(static_cast<std::size_t>(count), 0);
  for (int y = 0; y < labels.rows; ++y) {
    for (int x = 0; x < labels.cols; ++x) {
      const int label = labels(y, x);
      if (label == 0) continue;
      for (const cv::Point& step :
           {cv::Point(1, 0), cv::Point(-1, 0), cv::Point(0, 1), cv::Point(0, -1)}) {
        const cv::Point at = cv::Point(x, y) + step;
        if (at.x < 0 || at.y < 0 || at.x >= labels.cols || at.y >= labels.rows) continue;
        if ((*is_static)(at) != 0) {
          touches_static[static_cast<std::size_t>(label)] = 1;
        } else if (labels(at) == 0 && is_seen[at.y * labels.cols + at.x] != 0) {
          is_open[static_cast<std::size_t>(label)] = 1;
        }
      }
    }
  }
  for (int label = 1; label < count; ++label) {
    if (is_open[static_cast<std::size_t>(label)] == 0 &&
        touches_static[static_cast<std::size_t>(label)] != 0) {
      is_static->setTo(255, labels == label);
    }
  }
}

}  // namespace

StaticRegions::StaticRegions(const cv::Mat& domain, const StaticRegionOptions& options)
    : domain_(domain), options_(options) {}

cv::Rect StaticRegions::Area(int column, int row) const {
  return cv::Rect(column * kTilePx, row * kTilePx, kTilePx, kTilePx) & cv::Rect(cv::Point(), size_);
}

void StaticRegions::SetUp(const FlowPyramid& pyramid) {
  scale_ = pyramid.scale();
  size_ = pyramid.base().size();
  columns_ = (size_.width + kTilePx - 1) / kTilePx;
  rows_ = (size_.height + kTilePx - 1) / kTilePx;
  tiles_.assign(static_cast<std::size_t>(columns_ * rows_), {});
  mean_gradients_ = cv::Mat::zeros(size_, CV_32FC2);
  cv::Mat reduced;
  cv::resize(domain_, reduced, size_, 0.0, 0.0, cv::INTER_NEAREST);
  is_seen_.resize(tiles_.size());
  for (int i = 0; i < columns_ * rows_; ++i) {
    is_seen_[i] = cv::countNonZero(reduced(Area(i % columns_, i / columns_))) > 0 ? 1 : 0;
  }
}

/// The scene's motion at the centre of every cell; where the flow knows none, as what moves it has
/// left the image, that of the nearest cell.
std::vector<std::optional<Eigen::Vector2d>> StaticRegions::Steps(const SceneFlow& flow,
                                                                 double scale) const {
  const int columns = (columns_ + kTilesPerCell - 1) / kTilesPerCell;
  const int rows = (rows_ + kTilesPerCell - 1) / kTilesPerCell;
  const double cell_px = kTilesPerCell * kTilePx;
  std::vector<std::optional<Eigen::Vector2d>> known(static_cast<std::size_t>(columns * rows));
  for (int i = 0; i < columns * rows; ++i) {
    const Eigen::Vector2d center =
        scale * cell_px * Eigen::Vector2d(i % columns + 0.5, i / columns + 0.5);
    const auto warp = flow.Predict(center);
    if (warp) known[i] = (warp->center_px - center) / scale;
  }
  // Of the neighbourhood's motions the smallest counts: near the horizon things far and near mix.
  std::vector<std::optional<Eigen::Vector2d>> steps(known.size());
  for (int i = 0; i < columns * rows; ++i) {
    for (int reach = 1; !steps[i] && reach <= std::max(columns, rows); ++reach) {
      for (int y = i / columns - reach; y <= i / columns + reach; ++y) {
        for (int x = i % columns - reach; x <= i % columns + reach; ++x) {
          if (x < 0 || y < 0 || x >= columns || y >= rows || !known[y * columns + x]) continue;
          const Eigen::Vector2d& step = *known[y * columns + x];
          if (!steps[i] || step.norm() < steps[i]->norm()) steps[i] = step;
        }
      }
    }
  }
  return steps;
}

bool StaticRegions::Add(const FlowPyramid& pyramid, const SceneFlow* flow, int num_steps) {
  if (flow == nullptr || options_.min_samples == 0) return false;
  if (pyramid.base().size() != size_) SetUp(pyramid);
  const auto steps = Steps(*flow, scale_);
  const int cells_across = (columns_ + kTilesPerCell - 1) / kTilesPerCell;
  const double min_motion_px = options_.min_motion_px / scale_;
  bool is_sampled = false;
  for (int row = 0; row < rows_; ++row) {
    for (int column = 0; column < columns_; ++column) {
      const int i = row * columns_ + column;
      const auto& step = steps[row / kTilesPerCell * cells_across + column / kTilesPerCell];
      if (is_seen_[i] == 0 || !step) continue;
      Tile& tile = tiles_[i];
      tile.motion_px += num_steps * *step;
      if (tile.motion_px.norm() < min_motion_px) continue;
      Sample(pyramid.levels[1], Area(column, row), &tile);
      is_sampled = true;
    }
  }
  return is_sampled && UpdateMask();
}

/// Enters the gradients of one more image into the means.
void StaticRegions::Sample(const cv::Mat& gradients, const cv::Rect& area, Tile* tile) {
  tile->num_samples = std::min(tile->num_samples + 1, kMemory);
  const float share = 1.0F / static_cast<float>(tile->num_samples);
  float xx = 0.0F;
  float xy = 0.0F;
  float yy = 0.0F;
  for (int y = area.y; y < area.y + area.height; ++y) {
    const short* gradient = gradients.ptr<short>(y) + 2 * area.x;
    float* mean = mean_gradients_.ptr<float>(y) + 2 * area.x;
    for (int x = 0; x < area.width; ++x, gradient += 2, mean += 2) {
      const float gx = kPerLevel * static_cast<float>(gradient[0]);
      const float gy = kPerLevel * static_cast<float>(gradient[1]);
      mean[0] += share * (gx - mean[0]);
      mean[1] += share * (gy - mean[1]);
      xx += gx * gx;
      xy += gx * gy;
      yy += gy * gy;
    }
  }
  Eigen::Matrix2d energy;
  energy << xx, xy, xy, yy;
  const Eigen::Vector2d direction = tile->motion_px.normalized();
  tile->energy += share * (energy - tile->energy);
  tile->direction += share * (direction * direction.transpose() - tile->direction);
  tile->motion_px.setZero();
}

StaticRegions::Verdict StaticRegions::Judge(const cv::Rect& area, const Tile& tile) const {
  if (tile.num_samples < options_.min_samples) return Verdict::kUnknown;
  const double energy = tile.energy.cwiseProduct(tile.direction).sum();
  const double floor = options_.min_gradient * options_.min_gradient * area.area();
  if (energy < floor) return Verdict::kEmpty;
  float xx = 0.0F;
  float xy = 0.0F;
  float yy = 0.0F;
  for (int y = area.y; y < area.y + area.height; ++y) {
    const float* mean = mean_gradients_.ptr<float>(y) + 2 * area.x;
    for (int x = 0; x < area.width; ++x, mean += 2) {
      xx += mean[0] * mean[0];
      xy += mean[0] * mean[1];
      yy += mean[1] * mean[1];
    }
  }
  Eigen::Matrix2d of_mean;
  of_mean << xx, xy, xy, yy;
  return of_mean.cwiseProduct(tile.direction).sum() >= options_.min_lasting_share * energy
             ? Verdict::kStatic
             : Verdict::kMoving;
}

bool StaticRegions::UpdateMask() {
  cv::Mat1b is_static(rows_, columns_, uchar{0});
  cv::Mat1b is_empty(rows_, columns_, uchar{0});
  int num_seen = 0;
  for (int i = 0; i < columns_ * rows_; ++i) {
    if (is_seen_[i] == 0) continue;
    ++num_seen;
    const Verdict verdict = Judge(Area(i % columns_, i / columns_), tiles_[i]);
    if (verdict == Verdict::kStatic) is_static(i / columns_, i % columns_) = 255;
    if (verdict == Verdict::kEmpty) is_empty(i / columns_, i % columns_) = 255;
  }
  KeepClusters(&is_static);
  FillEnclosed(is_empty, is_seen_, &is_static);
  if (cv::countNonZero(is_static) > options_.max_share * num_seen) is_static.setTo(0);
  if (static_tiles_.size() == is_static.size() &&
      cv::countNonZero(static_tiles_ != is_static) == 0) {
    return false;
  }
  static_tiles_ = is_static;
  if (cv::countNonZero(is_static) == 0) {
    mask_.release();
    return true;
  }
  cv::Mat reduced;
  cv::resize(is_static, reduced, {columns_ * kTilePx, rows_ * kTilePx}, 0.0, 0.0,
             cv::INTER_NEAREST);
  cv::resize(reduced(cv::Rect(cv::Point(), size_)), mask_, domain_.size(), 0.0, 0.0,
             cv::INTER_NEAREST);
  return true;
}

}  // namespace scenecalib
