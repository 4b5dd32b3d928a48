#include "scenecalib/evaluation/result_table.h"

#include <gtest/gtest.h>

#include "evaluation_fixture.h"

namespace scenecalib {
namespace {

TEST(ResultTable, ShowsEveryCameraAndItsReasons) {
  const Rig initial = RigOf({ForwardCamera("front"), ForwardCamera("left")});
  CalibrationResult result;
  result.rig = RigOf(
      {Moved(ForwardCamera("front"), {0.0, 0.01, 0.0}, {0.03, 0.0, 0.04}), ForwardCamera("left")});
  result.reasons = {"1 of 2 cameras accepted"};
  result.cameras.resize(2);
  result.cameras[0].accepted = true;
  result.cameras[0].num_tracks = 1500;
  result.cameras[0].num_inlier_tracks = 1200;
  result.cameras[0].rms_before_px = 6.5;
  result.cameras[0].rms_after_px = 0.25;
  result.cameras[0].stddev.rotation_rad = {0.0, 0.001, 0.0};
  result.cameras[0].stddev.translation_m = {0.003, 0.0, 0.004};
  result.cameras[1].reasons = {"all images are black"};
  EXPECT_EQ(
      FormatResultTable(initial, result),
      "camera  accepted          rms px   tracks used  cross  moved deg  moved cm  stddev deg  "
      "stddev cm\n"
      "front        yes  6.500 -> 0.250  1200 of 1500      0      0.573       5.0       0.057      "
      " "
      " "
      "0.5\n"
      "left          no  0.000 -> 0.000        0 of 0      0      0.000       0.0       0.000      "
      " "
      " "
      "0.0\n"
      "1 of 2 cameras accepted\n"
      "left: all images are black\n");
}

TEST(ResultTable, ShowsTheErrorsAgainstATruthBeforeAndAfter) {
  const Rig truth = RigOf({ForwardCamera("front")});
  const Rig initial = RigOf({Moved(ForwardCamera("front"), {0.0, 0.01, 0.0}, {0.03, 0.0, 0.04})});
  const std::string table = FormatTruthTable(truth, initial, truth);
  EXPECT_NE(table.find("0.573 -> 0.000"), std::string::npos) << table;
  EXPECT_NE(table.find("5.00 -> 0.00"), std::string::npos) << table;
}

TEST(ResultTable, ACameraThatCannotBeComparedSaysWhy) {
  const Rig truth = RigOf({ForwardCamera("front"), ForwardCamera("rear")});
  const Rig estimate = RigOf({ForwardCamera("front")});
  const std::string table = FormatTruthTable(truth, estimate, estimate);
  EXPECT_NE(table.find("rear: camera rear of the truth is not in the estimate\n"),
            std::string::npos);
  EXPECT_NE(table.find("front"), std::string::npos);
}

}  // namespace
}  // namespace scenecalib
