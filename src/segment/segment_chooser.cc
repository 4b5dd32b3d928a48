#include "scenecalib/segment/segment_chooser.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "scenecalib/geometry/so3.h"

namespace scenecalib {
namespace {

constexpr double kRadPerDeg = 3.14159265358979323846 / 180.0;
/// Speeds of single steps are noisy: they are smoothed over about this time.
constexpr double kSpeedSmoothing_s = 1.0;

}  // namespace

std::string DriveSegment::Description() const {
  char text[200];
  std::snprintf(text, sizeof(text),
                "%.0f m in %.0f s from %.3f s on, %.0f degrees of turns, score %.0f", length_m,
                SecondsBetween(start_ns, end_ns), 1e-9 * static_cast<double>(start_ns),
                turn_rad / kRadPerDeg, score);
  return text;
}

void SegmentChooser::Add(const OdometrySample& sample) {
  if (!last_) {
    last_ = sample;
    return;
  }
  const double step_s = SecondsBetween(last_->stamp_ns, sample.stamp_ns);
  if (step_s <= 0.0) return;
  const bool gap = step_s > options_.max_gap_s;
  if (gap) {
    CloseBin();
    has_speed_ = false;
  }
  if (!is_open_) {
    open_ = Bin();
    open_.start_ns = gap ? sample.stamp_ns : last_->stamp_ns;
    open_.after_gap = gap;
    is_open_ = true;
  }
  if (!gap) {
    const Rigid3 motion = last_->odom_from_body.Inverse() * sample.odom_from_body;
    const Eigen::Vector3d turn = LogSo3(motion.rotation);
    const double length_m = motion.translation.norm();
    path_length_m_ += length_m;
    open_.length_m += length_m;
    open_.turn_rad += std::abs(turn.z());
    open_.tilt_rad += std::hypot(turn.x(), turn.y());
    const double share = std::min(1.0, step_s / kSpeedSmoothing_s);
    const double speed_m_s = length_m / step_s;
    const double before_m_s = has_speed_ ? last_speed_m_s_ : speed_m_s;
    last_speed_m_s_ = before_m_s + share * (speed_m_s - before_m_s);
    has_speed_ = true;
    open_.speed_change_m_s += std::abs(last_speed_m_s_ - before_m_s);
  }
  open_.end_ns = sample.stamp_ns;
  last_ = sample;
  if (open_.length_m >= std::max(bin_length_m_, options_.bin_length_m) ||
      SecondsBetween(open_.start_ns, open_.end_ns) >= options_.max_bin_duration_s) {
    CloseBin();
  }
}

void SegmentChooser::CloseBin() {
  if (!is_open_) return;
  is_open_ = false;
  bins_.push_back(open_);
  if (static_cast<int>(bins_.size()) >= options_.max_bins) MergeNeighbours();
}

void SegmentChooser::MergeNeighbours() {
  bin_length_m_ = 2.0 * std::max(bin_length_m_, options_.bin_length_m);
  std::vector<Bin> merged;
  for (const Bin& bin : bins_) {
    // A gap stays a border.
    if (merged.empty() || bin.after_gap || merged.back().length_m >= bin_length_m_ ||
        merged.back().length_m + bin.length_m > 1.5 * bin_length_m_) {
      merged.push_back(bin);
      continue;
    }
    Bin& into = merged.back();
    into.end_ns = bin.end_ns;
    into.length_m += bin.length_m;
    into.turn_rad += bin.turn_rad;
    into.tilt_rad += bin.tilt_rad;
    into.speed_change_m_s += bin.speed_change_m_s;
  }
  bins_ = std::move(merged);
}

double SegmentChooser::Score(const Bin& bin) const {
  const double duration_s = SecondsBetween(bin.start_ns, bin.end_ns);
  if (!(bin.length_m > 0.05 * options_.bin_length_m) || !(duration_s > 0.0)) return 0.0;
  // Each in metres driven at full excitation: a sharp turn must not outweigh a winding kilometre.
  const double turn = bin.turn_rad / (options_.turn_deg_m * kRadPerDeg);
  const double tilt = bin.tilt_rad / (options_.tilt_deg_m * kRadPerDeg);
  const double speed =
      bin.length_m * bin.speed_change_m_s / (options_.acceleration_m_s2 * duration_s);
  return std::min(turn, bin.length_m) + 0.25 * std::min(tilt, bin.length_m) +
         0.5 * std::min(speed, bin.length_m);
}

std::vector<DriveSegment> SegmentChooser::Choose() const {
  std::vector<DriveSegment> chosen;
  if (path_length_m_ < options_.min_recording_m) return chosen;
  std::vector<Bin> bins = bins_;
  if (is_open_) bins.push_back(open_);
  std::vector<double> scores;
  for (const Bin& bin : bins) scores.push_back(Score(bin));
  std::vector<bool> taken(bins.size(), false);
  while (static_cast<int>(chosen.size()) < options_.max_segments) {
    // The best window that is not too long, by moving both ends along.
    DriveSegment best;
    std::size_t best_first = 0;
    std::size_t best_last = 0;
    DriveSegment window;
    std::size_t first = 0;
    for (std::size_t last = 0; last < bins.size(); ++last) {
      if (taken[last] || bins[last].after_gap || (last > 0 && taken[last - 1])) {
        window = DriveSegment();
        first = last;
      }
      if (taken[last]) continue;
      window.length_m += bins[last].length_m;
      window.turn_rad += bins[last].turn_rad;
      window.score += scores[last];
      while (window.length_m > options_.max_length_m && first < last) {
        window.length_m -= bins[first].length_m;
        window.turn_rad -= bins[first].turn_rad;
        window.score -= scores[first];
        ++first;
      }
      if (window.score > best.score * (1.0 + 1e-9)) {
        best = window;
        best_first = first;
        best_last = last;
      }
    }
    if (!(best.score > 0.0)) break;
    best.start_ns = bins[best_first].start_ns;
    best.end_ns = bins[best_last].end_ns;
    std::fill(taken.begin() + static_cast<std::ptrdiff_t>(best_first),
              taken.begin() + static_cast<std::ptrdiff_t>(best_last) + 1, true);
    chosen.push_back(best);
  }
  return chosen;
}

}  // namespace scenecalib
