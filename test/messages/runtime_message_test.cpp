#include "soft_volume/messages/runtime_message.h"

#include <diagnostic_msgs/DiagnosticArray.h>
#include <geometry_msgs/PoseStamped.h>
#include <gtest/gtest.h>
#include <ros/serialization.h>
#include <sensor_msgs/Joy.h>
#include <std_msgs/Header.h>

#include <string>
#include <vector>

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

template <typename Message>
std::vector<std::uint8_t> bytesOf(const Message& message) {
  std::vector<std::uint8_t> bytes(ros::serialization::serializationLength(message));
  ros::serialization::OStream stream(bytes.data(), static_cast<std::uint32_t>(bytes.size()));
  ros::serialization::serialize(stream, message);
  return bytes;
}

template <typename Message>
RuntimeLayout layoutOf() {
  return {ros::message_traits::datatype<Message>(), ros::message_traits::definition<Message>()};
}

RuntimeFields read(const RuntimeLayout& layout, const std::vector<std::uint8_t>& bytes) {
  return layout.read(bytes.data(), bytes.size());
}

geometry_msgs::PoseStamped pose() {
  geometry_msgs::PoseStamped pose;
  pose.header.stamp = ros::Time(1700000000, 999999999);
  pose.header.frame_id = "base";
  pose.pose.position.x = 0.25;
  pose.pose.orientation.w = -1.0;
  return pose;
}

TEST(RuntimeMessage, FindsFieldsByName) {
  const RuntimeFields fields = read(layoutOf<geometry_msgs::PoseStamped>(), bytesOf(pose()));
  EXPECT_EQ(fields.number("pose.position.x"), 0.25);
  EXPECT_EQ(fields.number("pose.orientation.w"), -1.0);
  EXPECT_EQ(fields.number("header.stamp.secs"), 1700000000.0);
  EXPECT_EQ(fields.number("header.stamp.nsecs"), 999999999.0);
  EXPECT_EQ(fields.text("header.frame_id"), "base");
}

TEST(RuntimeMessage, WalksOverArraysOfAnything) {
  sensor_msgs::Joy joy;
  joy.axes = {0.5f, -0.5f};
  joy.buttons = {1, 0, 1};
  EXPECT_EQ(read(layoutOf<sensor_msgs::Joy>(), bytesOf(joy)).text("header.frame_id"), "");
  diagnostic_msgs::DiagnosticArray array;
  array.status.resize(3);
  array.status[1].name = "a name";
  array.status[2].values.resize(2);
  EXPECT_EQ(read(layoutOf<diagnostic_msgs::DiagnosticArray>(), bytesOf(array)).number("header.seq"), 0.0);
}

TEST(RuntimeMessage, KnowsEveryPrimitiveConstantsAndComments) {
  const RuntimeLayout layout("p/All",
                             "# int8 not_there\nint8 FLAG=-3\nstring WORD=a # b\n"
                             "bool a\nint8 b\nuint8 c # comment\nint16 d\nuint16 e\nint32 f\nuint32 g\nint64 h\n"
                             "uint64 i\nfloat32 j\nfloat64 k\nstring l\nduration m\nint16[2] n\nOther o\n\n"
                             "================================================================================\n"
                             "MSG: p/Other\nbyte[] raw\nchar last\n");
  std::vector<std::uint8_t> bytes;
  const auto put = [&bytes](auto value) {
    const auto* from = reinterpret_cast<const std::uint8_t*>(&value);
    bytes.insert(bytes.end(), from, from + sizeof(value));
  };
  put(std::uint8_t(1)), put(std::int8_t(-2)), put(std::uint8_t(200)), put(std::int16_t(-300)),
      put(std::uint16_t(60000));
  put(std::int32_t(-5)), put(std::uint32_t(4000000000u)), put(std::int64_t(-7)), put(std::uint64_t(8)), put(1.5f),
      put(2.5);
  put(std::uint32_t(2)), put('h'), put('i'), put(std::int32_t(-1)), put(std::int32_t(5));
  put(std::int16_t(1)), put(std::int16_t(2)), put(std::uint32_t(1)), put(std::int8_t(9)), put(std::uint8_t(77));
  const RuntimeFields fields = read(layout, bytes);
  const std::vector<std::pair<const char*, double>> expected = {
      {"a", 1},  {"b", -2}, {"c", 200}, {"d", -300}, {"e", 60000},   {"f", -5},      {"g", 4e9},
      {"h", -7}, {"i", 8},  {"j", 1.5}, {"k", 2.5},  {"m.secs", -1}, {"m.nsecs", 5}, {"o.last", 77}};
  for (const auto& [name, value] : expected)
    EXPECT_EQ(fields.number(name), value) << name;
  EXPECT_EQ(fields.text("l"), "hi");
  EXPECT_THROW(fields.number("FLAG"), core::InputError);
  EXPECT_THROW(fields.number("not_there"), core::InputError);
  EXPECT_THROW(fields.number("l"), core::InputError);
  EXPECT_THROW(fields.text("a"), core::InputError);
  EXPECT_THROW(fields.number("n"), core::InputError);
}

TEST(RuntimeMessage, RefusesBytesThatAreNoWholeMessage) {
  const RuntimeLayout layout = layoutOf<geometry_msgs::PoseStamped>();
  std::vector<std::uint8_t> bytes = bytesOf(pose());
  for (std::size_t size = 0; size < bytes.size(); ++size)
    EXPECT_THROW(layout.read(bytes.data(), size), core::InputError) << size;
  bytes.push_back(0);
  EXPECT_THROW(read(layout, bytes), core::InputError);
}

TEST(RuntimeMessage, AnArrayThatClaimsMoreThanItHoldsIsRefusedAtOnce) {
  const RuntimeLayout numbers("p/Numbers", "float64[] values\n");
  EXPECT_THROW(read(numbers, {255, 255, 255, 255, 0}), core::InputError);
  const RuntimeLayout nothings("p/Nothings", "Nothing[] values\n==========\nMSG: p/Nothing\n# empty\n");
  EXPECT_NO_THROW(read(nothings, {255, 255, 255, 255}));
  EXPECT_THROW(read(nothings, {255, 255, 255, 255, 0}), core::InputError);
}

TEST(RuntimeMessage, RefusesDefinitionsThatMakeNoSense) {
  EXPECT_THROW(RuntimeLayout("p/A", "B b\n"), core::InputError);
  EXPECT_THROW(RuntimeLayout("p/A", "A again\n"), core::InputError);
  EXPECT_THROW(RuntimeLayout("p/A", ""), core::InputError);
}

}  // namespace
}  // namespace soft_volume
