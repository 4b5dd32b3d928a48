#include "scenecalib/pipeline/study.h"

#include <gtest/gtest.h>

#include "testing/canyon_scene.h"

namespace scenecalib {
namespace {

class Study : public ::testing::Test {
 protected:
  Study() {
    testing::CanyonOptions canyon;
    canyon.tracks_per_camera = 250;
    scene_ = testing::MakeCanyonScene({testing::CanyonCamera("front", 0.0, 680.0, false),
                                       testing::CanyonCamera("left", 1.2, 330.0, true)},
                                      canyon);
    prepared_.mapping.map = scene_.map;
    prepared_.segments = scene_.segments;
    for (CameraSegment& segment : prepared_.segments) segment.num_images_in = 1;
    prepared_.refusals.resize(2);
    calibration_.hold_intrinsics = true;
    calibration_.joint.register_through_map = false;  // the scene has no images
    options_.starts = 5;
    options_.max_deg = 1.0;
    options_.max_m = 0.1;
  }
  testing::CanyonScene scene_;
  PipelineResult prepared_;
  CalibrationOptions calibration_;
  StudyOptions options_;
};

TEST_F(Study, StartsOfGrowingErrorEndInOnePlace) {
  const auto cameras = RunStudy(scene_.rig, prepared_, calibration_, options_, {});
  ASSERT_TRUE(cameras.ok()) << cameras.status().message();
  ASSERT_EQ(cameras->size(), 2u);
  for (const StudyCamera& camera : *cameras) {
    ASSERT_EQ(camera.outcomes.size(), 5u);
    EXPECT_EQ(camera.num_success, 5) << camera.name;
    EXPECT_LT(camera.outcomes.front().start_deg, camera.outcomes.back().start_deg);
    // Half to the whole of one degree on each of three axes.
    EXPECT_GT(camera.outcomes.back().start_deg, 0.5 * std::sqrt(3.0) - 1e-6);
    EXPECT_LT(camera.spread_m.maxCoeff(), 0.01);
    EXPECT_EQ(camera.num_accepted_elsewhere, 0);
  }
  const std::string csv = FormatStudyCsv(*cameras);
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 11);  // header, two cameras of five
  EXPECT_NE(FormatStudyPage(*cameras).find("<svg"), std::string::npos);
}

TEST_F(Study, TellsAfterEveryStartWhatIsKnownByThen) {
  std::vector<std::vector<StudyCamera>> told;
  const auto cameras = RunStudy(scene_.rig, prepared_, calibration_, options_, {},
                                [&told](const std::vector<StudyCamera>& so_far) {
                                  told.push_back(so_far);
                                  return Status::Ok();
                                });
  ASSERT_TRUE(cameras.ok()) << cameras.status().message();
  ASSERT_EQ(told.size(), 5u);
  for (std::size_t i = 0; i < told.size(); ++i) {
    EXPECT_EQ(told[i][0].outcomes.size(), i + 1);
    EXPECT_EQ(told[i][0].num_success, static_cast<int>(i) + 1);
  }
  EXPECT_EQ(FormatStudyCsv(told.back()), FormatStudyCsv(*cameras));
}

TEST_F(Study, EndsWhenItCannotBeWritten) {
  const auto cameras =
      RunStudy(scene_.rig, prepared_, calibration_, options_, {},
               [](const std::vector<StudyCamera>&) { return Status::Unavailable("disk full"); });
  EXPECT_EQ(cameras.status().message(), "disk full");
}

TEST_F(Study, CountsWhatIsAcceptedElsewhere) {
  options_.success_m = 1e-5;  // no two results are that equal
  const auto cameras = RunStudy(scene_.rig, prepared_, calibration_, options_, {});
  ASSERT_TRUE(cameras.ok()) << cameras.status().message();
  for (const StudyCamera& camera : *cameras) {
    EXPECT_GT(camera.num_accepted_elsewhere, 0);
    EXPECT_EQ(camera.num_success + camera.num_accepted_elsewhere, 5);
  }
  EXPECT_NE(FormatStudy(*cameras).find("accepted elsewhere"), std::string::npos);
}

TEST_F(Study, IsTheSameForTheSameSeed) {
  options_.starts = 2;
  const auto first = RunStudy(scene_.rig, prepared_, calibration_, options_, {});
  const auto second = RunStudy(scene_.rig, prepared_, calibration_, options_, {});
  ASSERT_TRUE(first.ok() && second.ok());
  EXPECT_EQ(FormatStudyCsv(*first), FormatStudyCsv(*second));
}

TEST_F(Study, CountsACameraThatCannotBeCalibratedAsFailed) {
  options_.starts = 2;
  prepared_.refusals[1] = "too dark";
  const auto cameras = RunStudy(scene_.rig, prepared_, calibration_, options_, {});
  ASSERT_TRUE(cameras.ok());
  EXPECT_EQ(cameras->at(0).num_success, 2);
  EXPECT_EQ(cameras->at(1).num_success, 0);
}

TEST_F(Study, SaysWhenNoStartSucceeds) {
  options_.starts = 2;
  prepared_.refusals = {"too dark", "too dark"};
  EXPECT_EQ(RunStudy(scene_.rig, prepared_, calibration_, options_, {}).status().code(),
            Status::Code::kInsufficientData);
}

TEST_F(Study, StopsWhenAskedTo) {
  EXPECT_EQ(
      RunStudy(scene_.rig, prepared_, calibration_, options_, [](const Progress&) { return false; })
          .status()
          .code(),
      Status::Code::kCancelled);
}

}  // namespace
}  // namespace scenecalib
