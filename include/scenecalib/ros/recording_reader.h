#pragma once

#include <string>
#include <vector>

#include "scenecalib/base/progress.h"
#include "scenecalib/base/status.h"
#include "scenecalib/pipeline/calibration_pipeline.h"
#include "scenecalib/ros/bag_recording.h"
#include "scenecalib/segment/segment_chooser.h"
#include "scenecalib/sensor/rig.h"

namespace scenecalib {

/// Whether the recording has every topic of the rig with the right type. NotFound or
/// InvalidArgument with one line that names the topic, who needs it, and what the recording has
/// instead.
Status CheckTopics(const BagRecording& recording, const Rig& rig);

/// Fills the models of cameras without intrinsics from their first camera_info message.
Result<Rig> ResolveIntrinsics(const Rig& rig, BagRecording* recording);

/// What was read.
struct ReadingReport {
  double duration_s = 0.0;  ///< of the recording
  int num_messages = 0;
  std::vector<std::string> warnings;  ///< damage and messages left out
};

/// The stretches of a long recording that are worth calibrating on, the best first, by receipt of
/// its odometry; nothing else is read. Empty for a short recording and without odometry: then all
/// of it is used.
std::vector<DriveSegment> ChooseStretches(const Rig& rig, const SegmentChoiceOptions& options,
                                          BagRecording* recording);

/// Feeds every measurement of the recording, or of a stretch of it, to the pipeline, each sensor in
/// its own thread from a bounded queue, so that a camera's tracking does not wait for the lidar's
/// odometry. The outcome does not depend on the threads' timing. Reports the stage "reading";
/// Cancelled when stopped.
Result<ReadingReport> FeedPipeline(const Rig& rig, int threads, BagRecording* recording,
                                   CalibrationPipeline* pipeline, const ProgressCallback& progress,
                                   const ReceiptWindow& window = ReceiptWindow());

}  // namespace scenecalib
