#include "scenecalib/pipeline/calibration_pipeline.h"

#include <tbb/global_control.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <mutex>
#include <thread>
#include <utility>

#include "scenecalib/pipeline/stream_check.h"
#include "scenecalib/tracking/camera_mask.h"

namespace scenecalib {
namespace {

/// One camera on its way through the pipeline.
struct CameraFeed {
  CameraFeed(const CameraConfig& config, const TrackingOptions& options, const cv::Mat& mask)
      : check("camera " + config.name + " (" + config.image_topic + ")"),
        tracker(config.name, config.model, options, mask) {}

  StreamCheck check;
  CameraTracker tracker;
};

/// Lets stages that run at the same time report to one callback, one at a time; once it said stop,
/// every stage is told so.
ProgressCallback Serialised(const ProgressCallback& progress) {
  if (!progress) return progress;
  struct State {
    std::mutex mutex;
    bool go_on = true;
  };
  auto state = std::make_shared<State>();
  return [state, progress](const Progress& p) {
    const std::lock_guard<std::mutex> lock(state->mutex);
    if (state->go_on) state->go_on = progress(p);
    return state->go_on;
  };
}

/// Why a camera's segment cannot be calibrated against this map; empty when it can.
std::string WhyUnusable(const CameraConfig& camera, const SceneMap& map,
                        const CameraSegment& segment) {
  if (segment.num_images_in == 0) return "no image arrived on " + camera.image_topic;
  int num_stamps = 0;
  int num_covered = 0;
  Timestamp first_ns = 0;
  for (const auto& [stamp_ns, image] : segment.images) {
    if (num_stamps++ == 0) first_ns = stamp_ns;
    if (map.map_from_lidar.Covers(AddSeconds(stamp_ns, camera.time_offset_s))) ++num_covered;
  }
  if (num_stamps == 0 || num_covered > 0) return {};
  char text[256];
  std::snprintf(
      text, sizeof(text),
      "none of the %d image stamps lies in the lidar's time (the first image is %+.3f s "
      "from the first scan): set the clocks, or time_offset_s in the rig file",
      num_stamps,
      SecondsBetween(map.map_from_lidar.start_ns(), AddSeconds(first_ns, camera.time_offset_s)));
  return text;
}

std::vector<const std::map<Timestamp, cv::Mat>*> ImagesOf(
    const std::vector<CameraSegment>& segments) {
  std::vector<const std::map<Timestamp, cv::Mat>*> images;
  for (const CameraSegment& segment : segments) images.push_back(&segment.images);
  return images;
}

using Rates = std::vector<std::optional<MiscalibrationRate>>;

void EnterRates(const Rates& before, const Rates& after, CalibrationResult* result) {
  for (std::size_t i = 0; i < result->cameras.size(); ++i) {
    result->cameras[i].miscalibration_rate_before = before[i];
    result->cameras[i].miscalibration_rate_after = after[i];
  }
}

}  // namespace

std::size_t NumThreads(int threads_option) {
  const unsigned int all = std::max(1U, std::thread::hardware_concurrency());
  return threads_option > 0 ? static_cast<std::size_t>(threads_option) : all;
}

struct CalibrationPipeline::Impl {
  Impl(const Rig& rig_in, const PipelineOptions& options_in, const std::vector<cv::Mat>& masks)
      : rig(rig_in),
        options(options_in),
        threads(tbb::global_control::max_allowed_parallelism, NumThreads(options_in.threads)),
        lidar_check("lidar (" + rig_in.lidar.topic + ")"),
        mapper(rig_in, options_in.mapping) {
    cameras.reserve(rig.cameras.size());
    for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
      cameras.emplace_back(rig.cameras[i], options.tracking, masks[i]);
    }
  }

  /// The map, and at the same time the cameras' verified tracks.
  Status MapAndTrack(const ProgressCallback& progress,
                     const std::optional<Trajectory>& known_map_from_lidar, PipelineResult* result);

  Rig rig;
  PipelineOptions options;
  tbb::global_control threads;  ///< in force as long as the pipeline lives
  StreamCheck lidar_check;
  SegmentMapper mapper;
  std::vector<CameraFeed> cameras;
  StageTimer feeding{"odometry and tracking"};
};

Status CalibrationPipeline::Impl::MapAndTrack(const ProgressCallback& progress,
                                              const std::optional<Trajectory>& known_map_from_lidar,
                                              PipelineResult* result) {
  const StageTimer timer("mapping");
  tbb::task_group group;
  result->segments.resize(cameras.size());
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    group.run([this, i, result] { result->segments[i] = cameras[i].tracker.Segment(); });
  }
  Result<MappingResult> mapping =
      known_map_from_lidar ? mapper.BuildMapWithTrajectory(*known_map_from_lidar, progress)
                           : mapper.BuildMap(progress);
  group.wait();
  result->costs.push_back(timer.Stop());
  if (!mapping.ok()) return mapping.status();
  result->mapping = std::move(mapping).value();
  return Status::Ok();
}

Result<CalibrationPipeline> CalibrationPipeline::Create(const Rig& rig,
                                                        const PipelineOptions& options) {
  SCENECALIB_RETURN_IF_ERROR(CheckOptions(options));
  if (rig.cameras.empty()) return Status::InvalidArgument("the rig has no camera");
  for (const CameraConfig& camera : rig.cameras) {
    if (!camera.model) {
      return Status::InvalidArgument("camera " + camera.name +
                                     " has no intrinsics: neither in the rig file nor from "
                                     "camera_info");
    }
  }
  std::vector<cv::Mat> masks;
  for (const CameraConfig& camera : rig.cameras) {
    Result<cv::Mat> mask = ReadCameraMask(camera);
    if (!mask.ok()) return mask.status();
    masks.push_back(*mask);
  }
  return CalibrationPipeline(std::make_unique<Impl>(rig, options, masks));
}

CalibrationPipeline::CalibrationPipeline(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
CalibrationPipeline::CalibrationPipeline(CalibrationPipeline&&) noexcept = default;
CalibrationPipeline& CalibrationPipeline::operator=(CalibrationPipeline&&) noexcept = default;
CalibrationPipeline::~CalibrationPipeline() = default;

void CalibrationPipeline::AddImu(const ImuSample& sample) { impl_->mapper.AddImu(sample); }

void CalibrationPipeline::AddOdometry(const OdometrySample& sample) {
  impl_->mapper.AddOdometry(sample);
}

Status CalibrationPipeline::AddScan(const LidarScan& scan) {
  SCENECALIB_RETURN_IF_ERROR(impl_->lidar_check.Note(scan.stamp_ns));
  const Result<ScanRegistration> registration = impl_->mapper.AddScan(scan);
  if (!registration.ok()) impl_->lidar_check.NoteRejected(registration.status().message());
  return registration.status();
}

Status CalibrationPipeline::AddImage(int camera, const GrayImage& image) {
  CameraFeed& feed = impl_->cameras[static_cast<std::size_t>(camera)];
  SCENECALIB_RETURN_IF_ERROR(feed.check.Note(image.stamp_ns));
  const Result<FrameTracking> tracking = feed.tracker.AddImage(image);
  if (!tracking.ok()) feed.check.NoteRejected(tracking.status().message());
  return tracking.status();
}

void CalibrationPipeline::NoteRejectedScan(const std::string& reason) {
  impl_->lidar_check.NoteUndecoded(reason);
}

void CalibrationPipeline::NoteRejectedImage(int camera, const std::string& reason) {
  impl_->cameras[static_cast<std::size_t>(camera)].check.NoteUndecoded(reason);
}

Result<PipelineResult> CalibrationPipeline::Prepare(
    const ProgressCallback& progress, const std::optional<Trajectory>& known_map_from_lidar) {
  const ProgressCallback serialised = Serialised(progress);
  const PipelineOptions& options = impl_->options;
  PipelineResult result;
  result.initial_rig = impl_->rig;
  result.costs.push_back(impl_->feeding.Stop());

  SCENECALIB_RETURN_IF_ERROR(impl_->lidar_check.Check(options.stream_check, true));
  SCENECALIB_RETURN_IF_ERROR(impl_->MapAndTrack(serialised, known_map_from_lidar, &result));
  const std::string lidar_warning = impl_->lidar_check.Warning();
  if (!lidar_warning.empty()) result.warnings.push_back(lidar_warning);

  result.refusals.resize(result.segments.size());
  for (std::size_t i = 0; i < result.refusals.size(); ++i) {
    const StreamCheck& check = impl_->cameras[i].check;
    result.refusals[i] = check.Check(options.stream_check, false).message();
    if (result.refusals[i].empty() && !result.segments[i].images.empty()) {
      result.refusals[i] = WhyUnfit(MeasureFitness(result.segments[i]), options.fitness);
    }
    const std::string warning = check.Warning();
    if (!warning.empty()) result.warnings.push_back(warning);
  }
  return Result<PipelineResult>(std::move(result));
}

Result<PipelineResult> CalibrationPipeline::Run(
    const ProgressCallback& progress, const std::optional<Trajectory>& known_map_from_lidar) {
  Result<PipelineResult> result = Prepare(progress, known_map_from_lidar);
  if (!result.ok()) return result.status();
  SCENECALIB_RETURN_IF_ERROR(CheckMapFitness(result->mapping.report, impl_->options.fitness));
  const StageTimer timer("calibration");
  Result<RigCalibration> calibration = CalibrateSegments(
      impl_->rig, result->mapping.map, result->segments, result->refusals,
      impl_->options.calibration, impl_->options.miscalibration, Serialised(progress));
  result->costs.push_back(timer.Stop());
  if (!calibration.ok()) return calibration.status();
  result->calibration = std::move(calibration).value();
  return result;
}

Status AddMiscalibrationRates(const Rig& initial, const SceneMap& map,
                              const std::vector<CameraSegment>& segments,
                              const MiscalibrationOptions& options, CalibrationResult* result) {
  if (options.num_times == 0) return Status::Ok();
  const auto rates =
      ComputeMiscalibrationRates({initial, result->rig}, map, ImagesOf(segments), options);
  if (!rates.ok()) return rates.status();
  EnterRates((*rates)[0], (*rates)[1], result);
  return Status::Ok();
}

Result<RigCalibration> CalibrateSegments(const Rig& initial, const SceneMap& map,
                                         std::vector<CameraSegment> segments,
                                         std::vector<std::string> refusals,
                                         const CalibrationOptions& options,
                                         const MiscalibrationOptions& miscalibration,
                                         const ProgressCallback& progress) {
  refusals.resize(segments.size());
  std::string all_refusals;
  for (std::size_t i = 0; i < segments.size(); ++i) {
    if (refusals[i].empty()) refusals[i] = WhyUnusable(initial.cameras[i], map, segments[i]);
    if (refusals[i].empty()) continue;
    segments[i] = CameraSegment();
    all_refusals += "; camera " + initial.cameras[i].name + ": " + refusals[i];
  }
  const auto with_refusals = [&all_refusals](const Status& status) {
    return Status(status.code(), status.message() + all_refusals);
  };
  const Result<RayCaster> surfaces = RayCaster::Create(map);
  if (!surfaces.ok()) return with_refusals(surfaces.status());
  MiscalibrationRater rater(map, *surfaces, ImagesOf(segments), miscalibration);
  Result<Rates> before = Status::Cancelled("not rated");
  Result<RigCalibration> calibration =
      CalibrateRig(initial, map, *surfaces, segments, options, progress,
                   [&](const std::atomic<bool>& failed) { before = rater.Rate(initial, failed); });
  if (!calibration.ok()) return with_refusals(calibration.status());
  if (!before.ok()) return before.status();
  for (std::size_t i = 0; i < refusals.size(); ++i) {
    if (refusals[i].empty()) continue;
    std::vector<std::string>& reasons = calibration->result.cameras[i].reasons;
    reasons.insert(reasons.begin(), refusals[i]);
  }
  const Result<Rates> after = rater.Rate(calibration->result.rig, std::atomic<bool>(false));
  if (!after.ok()) return after.status();
  EnterRates(*before, *after, &calibration->result);
  return calibration;
}

}  // namespace scenecalib
