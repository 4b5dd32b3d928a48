#include "scenecalib/ros/recording_reader.h"

#include <nav_msgs/Odometry.h>
#include <ros/serialization.h>
#include <sensor_msgs/CameraInfo.h>
#include <sensor_msgs/CompressedImage.h>
#include <sensor_msgs/Image.h>
#include <sensor_msgs/Imu.h>
#include <sensor_msgs/PointCloud2.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <exception>
#include <map>
#include <memory>
#include <set>
#include <utility>

#include "scenecalib/ros/bounded_worker.h"
#include "scenecalib/ros/image_conversion.h"
#include "scenecalib/ros/message_conversion.h"
#include "scenecalib/ros/point_cloud_conversion.h"

namespace scenecalib {
namespace {

/// Messages waiting per sensor.
constexpr std::size_t kQueueLength = 16;
/// IMU and odometry messages that wait for a scan.
constexpr std::size_t kMaxBatch = 1000;

template <typename Message>
std::string DataType() {
  return ros::message_traits::DataType<Message>::value();
}

template <typename Message>
std::string Md5Sum() {
  return ros::message_traits::MD5Sum<Message>::value();
}

/// The serialised message as its type. InvalidArgument when its bytes are not that.
template <typename Message>
Result<Message> Deserialise(const BagMessage& raw) {
  if (raw.datatype != DataType<Message>() || raw.md5sum != Md5Sum<Message>()) {
    return Status::InvalidArgument("message is a " + raw.datatype + ", not a " +
                                   DataType<Message>());
  }
  try {
    Message message;
    // IStream reads only, whatever its signature says.
    ros::serialization::IStream stream(const_cast<std::uint8_t*>(raw.bytes.data()),
                                       static_cast<std::uint32_t>(raw.bytes.size()));
    ros::serialization::deserialize(stream, message);
    return message;
  } catch (const std::exception& error) {
    return Status::InvalidArgument(std::string("message is damaged: ") + error.what());
  }
}

/// A topic that the rig needs, and the types that would do.
struct NeededTopic {
  std::string name;
  std::string needed_by;
  std::string remedy;
  std::map<std::string, std::string> md5sum_by_type;
};

std::vector<NeededTopic> NeededTopics(const Rig& rig) {
  std::vector<NeededTopic> needed;
  needed.push_back({rig.lidar.topic,
                    "lidar.topic",
                    "name one of those as lidar.topic in the rig file",
                    {{DataType<sensor_msgs::PointCloud2>(), Md5Sum<sensor_msgs::PointCloud2>()}}});
  if (rig.imu) {
    needed.push_back({rig.imu->topic,
                      "imu.topic",
                      "correct imu.topic in the rig file, or leave out its imu block",
                      {{DataType<sensor_msgs::Imu>(), Md5Sum<sensor_msgs::Imu>()}}});
  }
  if (rig.odometry) {
    needed.push_back({rig.odometry->topic,
                      "odometry.topic",
                      "correct odometry.topic in the rig file, or leave out its odometry block",
                      {{DataType<nav_msgs::Odometry>(), Md5Sum<nav_msgs::Odometry>()}}});
  }
  for (const CameraConfig& camera : rig.cameras) {
    needed.push_back(
        {camera.image_topic,
         "cameras." + camera.name + ".image_topic",
         "correct the topic in the rig file, or leave out the camera",
         {{DataType<sensor_msgs::Image>(), Md5Sum<sensor_msgs::Image>()},
          {DataType<sensor_msgs::CompressedImage>(), Md5Sum<sensor_msgs::CompressedImage>()}}});
    if (camera.model || !camera.camera_info_topic) continue;
    needed.push_back({*camera.camera_info_topic,
                      "cameras." + camera.name + ".camera_info_topic",
                      "correct the topic, or give intrinsics in the rig file",
                      {{DataType<sensor_msgs::CameraInfo>(), Md5Sum<sensor_msgs::CameraInfo>()}}});
  }
  return needed;
}

std::string TypeNames(const NeededTopic& needed) {
  std::string names;
  for (const auto& [type, md5sum] : needed.md5sum_by_type) {
    names += (names.empty() ? "" : " or ") + type;
  }
  return names;
}

/// "/a, /b", the recording's topics of a type that would do, or "none".
std::string Candidates(const std::vector<BagTopic>& topics, const NeededTopic& needed) {
  std::string names;
  for (const BagTopic& topic : topics) {
    if (needed.md5sum_by_type.count(topic.datatype) == 0) continue;
    names += (names.empty() ? "" : ", ") + topic.name;
  }
  return names.empty() ? "none" : names;
}

/// Where a topic's messages go. Each sensor's tasks run in one thread, one after the other.
class PipelineFeeder {
 public:
  PipelineFeeder(const Rig& rig, int threads, CalibrationPipeline* pipeline)
      : rig_(rig),
        pipeline_(pipeline),
        slots_(NumThreads(threads)),
        lidar_(std::make_unique<BoundedWorker>(kQueueLength)),
        converters_(rig.cameras.size()) {
    for (std::size_t i = 0; i < rig.cameras.size(); ++i) {
      cameras_.push_back(std::make_unique<BoundedWorker>(kQueueLength));
    }
  }

  std::set<std::string> Topics() const {
    std::set<std::string> topics = {rig_.lidar.topic};
    if (rig_.imu) topics.insert(rig_.imu->topic);
    if (rig_.odometry) topics.insert(rig_.odometry->topic);
    for (const CameraConfig& camera : rig_.cameras) topics.insert(camera.image_topic);
    return topics;
  }

  void Feed(BagMessage&& raw) {
    const auto message = std::make_shared<const BagMessage>(std::move(raw));
    if (message->topic == rig_.lidar.topic) {
      motion_.push_back([this, message] { HandleScan(*message); });
      PushMotion();
    } else if (rig_.imu && message->topic == rig_.imu->topic) {
      motion_.push_back([this, message] { HandleImu(*message); });
    } else if (rig_.odometry && message->topic == rig_.odometry->topic) {
      motion_.push_back([this, message] { HandleOdometry(*message); });
    }
    if (motion_.size() >= kMaxBatch) PushMotion();
    for (std::size_t i = 0; i < rig_.cameras.size(); ++i) {
      if (message->topic != rig_.cameras[i].image_topic) continue;
      Push(cameras_[i].get(), [this, i, message] { HandleImage(static_cast<int>(i), *message); });
    }
  }

  /// Around the reading, in the thread that calls Feed().
  void Begin() { slots_.TakeFirst(); }
  void Finish() {
    PushMotion();
    slots_.Give();
    lidar_->Finish();
    for (const auto& camera : cameras_) camera->Finish();
  }

  int num_refused_motion() const { return num_refused_motion_; }

 private:
  /// Counts the threads at work: no more than asked for.
  class Slots {
   public:
    explicit Slots(std::size_t count) : free_(count) {}
    void Take() {
      std::unique_lock<std::mutex> lock(mutex_);
      changed_.wait(lock, [this] { return free_ > 0 && !first_waits_; });
      --free_;
    }
    /// Before all who wait in Take().
    void TakeFirst() {
      std::unique_lock<std::mutex> lock(mutex_);
      first_waits_ = true;
      changed_.wait(lock, [this] { return free_ > 0; });
      first_waits_ = false;
      --free_;
      changed_.notify_all();
    }
    void Give() {
      const std::lock_guard<std::mutex> lock(mutex_);
      ++free_;
      changed_.notify_all();
    }

   private:
    std::mutex mutex_;
    std::condition_variable changed_;
    std::size_t free_;
    bool first_waits_ = false;
  };

  /// A scan together with the IMU and odometry messages before it: by themselves these would fill
  /// the queue after a tenth of a second.
  void PushMotion() {
    if (motion_.empty()) return;
    Push(lidar_.get(), [batch = std::exchange(motion_, {})] {
      for (const std::function<void()>& handle : batch) handle();
    });
  }

  /// The reader holds a slot of its own except where it waits for room: unpacking a bag is work of
  /// one thread, and whoever waits for its messages leaves the other processors idle.
  void Push(BoundedWorker* worker, std::function<void()> handle) {
    std::function<void()> task = [this, handle = std::move(handle)] {
      slots_.Take();
      handle();
      slots_.Give();
    };
    if (worker->TryPush(task)) return;
    slots_.Give();
    worker->Push(std::move(task));
    slots_.TakeFirst();
  }

  void HandleScan(const BagMessage& raw) {
    const Result<sensor_msgs::PointCloud2> message = Deserialise<sensor_msgs::PointCloud2>(raw);
    if (!message.ok()) return pipeline_->NoteRejectedScan(message.status().message());
    const Result<LidarScan> scan = DecodeScan(*message, rig_.lidar);
    if (!scan.ok()) return pipeline_->NoteRejectedScan(scan.status().message());
    (void)pipeline_->AddScan(*scan);  // counted there
  }

  void HandleImu(const BagMessage& raw) {
    const Result<sensor_msgs::Imu> message = Deserialise<sensor_msgs::Imu>(raw);
    const Result<ImuSample> sample =
        message.ok() ? FromMessage(*message) : Result<ImuSample>(message.status());
    if (!sample.ok()) {
      ++num_refused_motion_;
    } else {
      pipeline_->AddImu(*sample);
    }
  }

  void HandleOdometry(const BagMessage& raw) {
    const Result<nav_msgs::Odometry> message = Deserialise<nav_msgs::Odometry>(raw);
    const Result<OdometrySample> sample =
        message.ok() ? FromMessage(*message) : Result<OdometrySample>(message.status());
    if (!sample.ok()) {
      ++num_refused_motion_;
    } else {
      pipeline_->AddOdometry(*sample);
    }
  }

  void HandleImage(int camera, const BagMessage& raw) {
    const Result<GrayImage> image = Decode(raw, &converters_[static_cast<std::size_t>(camera)]);
    if (!image.ok()) return pipeline_->NoteRejectedImage(camera, image.status().message());
    (void)pipeline_->AddImage(camera, *image);  // counted there
  }

  static Result<GrayImage> Decode(const BagMessage& raw, ImageConverter* converter) {
    if (raw.datatype == DataType<sensor_msgs::CompressedImage>()) {
      const auto message = Deserialise<sensor_msgs::CompressedImage>(raw);
      return message.ok() ? converter->Convert(*message) : Result<GrayImage>(message.status());
    }
    const auto message = Deserialise<sensor_msgs::Image>(raw);
    return message.ok() ? converter->Convert(*message) : Result<GrayImage>(message.status());
  }

  const Rig& rig_;
  CalibrationPipeline* pipeline_;
  Slots slots_;
  std::vector<std::function<void()>> motion_;
  std::unique_ptr<BoundedWorker> lidar_;
  std::vector<std::unique_ptr<BoundedWorker>> cameras_;
  std::vector<ImageConverter> converters_;
  std::atomic<int> num_refused_motion_{0};
};

std::string RateText(double recorded_s, double elapsed_s) {
  char text[64];
  std::snprintf(text, sizeof(text), "%.1f s of recording, %.2f x real time", recorded_s,
                elapsed_s > 0.0 ? recorded_s / elapsed_s : 0.0);
  return text;
}

}  // namespace

Status CheckTopics(const BagRecording& recording, const Rig& rig) {
  const std::vector<BagTopic> topics = recording.topics();
  for (const NeededTopic& needed : NeededTopics(rig)) {
    const BagTopic* found = nullptr;
    for (const BagTopic& topic : topics) {
      if (topic.name == needed.name) found = &topic;
    }
    const std::string has = "; of type " + TypeNames(needed) +
                            " it has: " + Candidates(topics, needed) + " - " + needed.remedy;
    const std::string what = "topic " + needed.name + " (" + needed.needed_by + ") ";
    if (!found || found->num_messages == 0) {
      return Status::NotFound(what + "is not in " + recording.name() + has);
    }
    const auto type = needed.md5sum_by_type.find(found->datatype);
    if (type == needed.md5sum_by_type.end()) {
      return Status::InvalidArgument(what + "is of type " + found->datatype + has);
    }
    if (type->second != found->md5sum) {
      return Status::InvalidArgument(what + "was recorded with another definition of " +
                                     found->datatype + ": convert the bag (rosbag fix)");
    }
  }
  return Status::Ok();
}

Result<Rig> ResolveIntrinsics(const Rig& rig, BagRecording* recording) {
  Rig resolved = rig;
  for (CameraConfig& camera : resolved.cameras) {
    if (camera.model || !camera.camera_info_topic) continue;
    Status status =
        Status::NotFound("camera " + camera.name + ": no message on " + *camera.camera_info_topic);
    recording->ForEachMessage({*camera.camera_info_topic}, [&](BagMessage&& raw) {
      const Result<sensor_msgs::CameraInfo> info = Deserialise<sensor_msgs::CameraInfo>(raw);
      const Result<CameraModelPtr> model =
          info.ok() ? CameraModelFromInfo(*info) : Result<CameraModelPtr>(info.status());
      if (model.ok()) camera.model = *model;
      status = model.ok() ? Status::Ok()
                          : Status::InvalidArgument("camera " + camera.name + " (" +
                                                    *camera.camera_info_topic +
                                                    "): " + model.status().message());
      return false;
    });
    SCENECALIB_RETURN_IF_ERROR(status);
  }
  return Result<Rig>(std::move(resolved));
}

std::vector<DriveSegment> ChooseStretches(const Rig& rig, const SegmentChoiceOptions& options,
                                          BagRecording* recording) {
  constexpr double kMaxSpeed_m_s = 40.0;  // a recording too short to be long is not even scanned
  const double duration_s = SecondsBetween(recording->begin_ns(), recording->end_ns());
  if (!rig.odometry || duration_s * kMaxSpeed_m_s < options.min_recording_m) return {};
  SegmentChooser chooser(options);
  recording->ForEachMessage({rig.odometry->topic}, [&](BagMessage&& raw) {
    const Result<nav_msgs::Odometry> message = Deserialise<nav_msgs::Odometry>(raw);
    const Result<OdometrySample> sample =
        message.ok() ? FromMessage(*message) : Result<OdometrySample>(message.status());
    // By receipt, because that is what the recording is cut by.
    if (sample.ok()) chooser.Add({raw.receipt_ns, sample->odom_from_body});
    return true;
  });
  return chooser.Choose();
}

Result<ReadingReport> FeedPipeline(const Rig& rig, int threads, BagRecording* recording,
                                   CalibrationPipeline* pipeline, const ProgressCallback& progress,
                                   const ReceiptWindow& window) {
  ReadingReport report;
  const Timestamp begin_ns = std::max(window.begin_ns, recording->begin_ns());
  report.duration_s = SecondsBetween(begin_ns, std::min(window.end_ns, recording->end_ns()));
  PipelineFeeder feeder(rig, threads, pipeline);
  const auto start = std::chrono::steady_clock::now();
  bool go_on = true;
  const auto feed = [&](BagMessage&& message) {
    const double recorded_s = SecondsBetween(begin_ns, message.receipt_ns);
    feeder.Feed(std::move(message));
    ++report.num_messages;
    if (report.num_messages % 50 == 0) {
      const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
      go_on = ReportProgress(progress, "reading",
                             report.duration_s > 0.0 ? recorded_s / report.duration_s : 1.0,
                             RateText(recorded_s, elapsed.count()));
    }
    return go_on;
  };
  feeder.Begin();
  recording->ForEachMessage(feeder.Topics(), feed, window);
  feeder.Finish();
  if (!go_on) return Status::Cancelled("stopped while reading " + recording->name());
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  ReportProgress(progress, "reading", 1.0, RateText(report.duration_s, elapsed.count()));
  report.warnings = recording->damages();
  if (feeder.num_refused_motion() > 0) {
    report.warnings.push_back(std::to_string(feeder.num_refused_motion()) +
                              " IMU or odometry messages skipped: damaged or not finite");
  }
  return report;
}

}  // namespace scenecalib
