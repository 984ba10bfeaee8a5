#include "soft_volume/messages/runtime_message.h"

#include <cstdlib>
#include <cstring>
#include <sstream>

#include "soft_volume/common/error.h"

namespace soft_volume {
namespace {

/// Deeper than any real message; one that contains itself is refused by it.
constexpr int kDeepest = 16;

struct Primitive {
  const char* name;
  char kind;  // i, u, f or s
  std::size_t bytes;
};
constexpr Primitive kPrimitives[] = {{"bool", 'u', 1},    {"byte", 'i', 1},  {"char", 'u', 1},   {"int8", 'i', 1},
                                     {"uint8", 'u', 1},   {"int16", 'i', 2}, {"uint16", 'u', 2}, {"int32", 'i', 4},
                                     {"uint32", 'u', 4},  {"int64", 'i', 8}, {"uint64", 'u', 8}, {"float32", 'f', 4},
                                     {"float64", 'f', 8}, {"string", 's', 0}};

const Primitive* findPrimitive(const std::string& name) {
  for (const Primitive& primitive : kPrimitives) {
    if (name == primitive.name)
      return &primitive;
  }
  return nullptr;
}

bool isRule(const std::string& line) {
  return line.size() >= 10 && line.find_first_not_of('=') == std::string::npos;
}

template <typename Number>
double as(const std::uint8_t* data) {
  Number value;
  std::memcpy(&value, data, sizeof(value));  // messages are little-endian, as are the machines that ROS 1 runs on
  return static_cast<double>(value);
}

}  // namespace

double RuntimeFields::number(const std::string& field) const {
  const auto found = numbers_.find(field);
  if (found == numbers_.end())
    throw core::InputError("the message has no number '" + field + "'");
  return found->second;
}

const std::string& RuntimeFields::text(const std::string& field) const {
  const auto found = texts_.find(field);
  if (found == texts_.end())
    throw core::InputError("the message has no text '" + field + "'");
  return found->second;
}

RuntimeLayout::RuntimeLayout(const std::string& type, const std::string& definition) : type_(type) {
  Definitions definitions;
  std::string current = type;
  std::istringstream lines(definition);
  for (std::string line; std::getline(lines, line);) {
    if (isRule(line))
      current.clear();
    else if (current.empty() && line.compare(0, 5, "MSG: ") == 0)
      current = line.substr(5, line.find_last_not_of(" \r") - 4);
    else
      definitions[current] += line + "\n";
  }
  fields_ = parse(type, definitions, 0);
}

std::vector<RuntimeLayout::Field> RuntimeLayout::parse(const std::string& type, const Definitions& definitions,
                                                       int depth) {
  const auto found = definitions.find(type);
  if (found == definitions.end() || depth > kDeepest)
    throw core::InputError("the definition of " + type + " is missing, or contains itself");
  const std::string package = type.substr(0, type.find('/'));
  std::vector<Field> fields;
  std::istringstream lines(found->second);
  for (std::string line; std::getline(lines, line);) {
    line = line.substr(0, line.find('#'));
    std::istringstream words(line);
    std::string field_type, name;
    // A constant has a = and takes no room in the message.
    if ((words >> field_type >> name) && line.find('=') == std::string::npos)
      fields.push_back(parseField(field_type, name, package, definitions, depth));
  }
  return fields;
}

RuntimeLayout::Field RuntimeLayout::parseField(const std::string& field_type, const std::string& name,
                                               const std::string& package, const Definitions& definitions, int depth) {
  Field field;
  field.name = name;
  std::string type = field_type;
  const std::size_t bracket = type.find('[');
  if (bracket != std::string::npos) {
    field.is_array = true;
    field.length = static_cast<std::uint32_t>(std::strtoul(type.c_str() + bracket + 1, nullptr, 10));
    type = type.substr(0, bracket);
  }
  if (const Primitive* primitive = findPrimitive(type)) {
    constexpr Kind kKinds[] = {Kind::kInteger, Kind::kUnsigned, Kind::kFloat, Kind::kText};
    field.kind = kKinds[std::strchr("iufs", primitive->kind) - "iufs"];
    field.bytes = primitive->bytes;
  } else if (type == "time" || type == "duration") {
    const Kind kind = type == "time" ? Kind::kUnsigned : Kind::kInteger;
    field.fields = {{"secs", kind, 4, false, 0, {}}, {"nsecs", kind, 4, false, 0, {}}};
  } else {
    if (type == "Header")
      type = "std_msgs/Header";
    else if (type.find('/') == std::string::npos)
      type = package + "/" + type;
    field.fields = parse(type, definitions, depth + 1);
  }
  return field;
}

/// Walks through the bytes of one message.
class RuntimeLayout::Reader {
 public:
  Reader(const std::uint8_t* data, std::size_t size) : data_(data), left_(size) {}

  /// `out` is null inside of arrays.
  void readAll(const std::vector<Field>& fields, const std::string& prefix, RuntimeFields* out) {
    for (const Field& field : fields)
      read(field, prefix + field.name, out);
  }
  bool atEnd() const { return left_ == 0; }

 private:
  void read(const Field& field, const std::string& name, RuntimeFields* out) {
    if (!field.is_array)
      return readOne(field, name, out);
    const std::uint32_t length = field.length > 0 ? field.length : readLength();
    for (std::uint32_t n = 0; n < length; ++n) {
      const std::size_t before = left_;
      readOne(field, name, nullptr);
      if (left_ == before)  // elements that take no room, however many of them there are said to be
        break;
    }
  }

  void readOne(const Field& field, const std::string& name, RuntimeFields* out) {
    if (field.kind == Kind::kMessage)
      return readAll(field.fields, name + ".", out);
    if (field.kind == Kind::kText) {
      const std::uint32_t length = readLength();
      const auto* text = reinterpret_cast<const char*>(take(length));
      if (out != nullptr)
        out->texts_[name].assign(text, length);
      return;
    }
    const double value = toNumber(field, take(field.bytes));
    if (out != nullptr)
      out->numbers_[name] = value;
  }

  static double toNumber(const Field& field, const std::uint8_t* data) {
    const bool is_signed = field.kind == Kind::kInteger;
    if (field.kind == Kind::kFloat)
      return field.bytes == 4 ? as<float>(data) : as<double>(data);
    switch (field.bytes) {
      case 1:
        return is_signed ? as<std::int8_t>(data) : as<std::uint8_t>(data);
      case 2:
        return is_signed ? as<std::int16_t>(data) : as<std::uint16_t>(data);
      case 4:
        return is_signed ? as<std::int32_t>(data) : as<std::uint32_t>(data);
      default:
        return is_signed ? as<std::int64_t>(data) : as<std::uint64_t>(data);
    }
  }

  std::uint32_t readLength() {
    std::uint32_t length;
    std::memcpy(&length, take(4), 4);
    return length;
  }

  const std::uint8_t* take(std::size_t bytes) {
    if (bytes > left_)
      throw core::InputError("the message is shorter than its type says");
    const std::uint8_t* at = data_;
    data_ += bytes;
    left_ -= bytes;
    return at;
  }

  const std::uint8_t* data_;
  std::size_t left_;
};

RuntimeFields RuntimeLayout::read(const std::uint8_t* data, std::size_t size) const {
  RuntimeFields fields;
  Reader reader(data, size);
  reader.readAll(fields_, "", &fields);
  if (!reader.atEnd())
    throw core::InputError("the message is longer than its type " + type_ + " says");
  return fields;
}

}  // namespace soft_volume
