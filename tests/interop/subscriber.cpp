// A ROS 2 subscriber with Fast DDS, the default middleware of ROS 2, and without code of hubodo: it
// decodes the messages with Fast CDR in the order of the ROS IDL and prints one line of JSON for each topic.
//
//     subscriber DOMAIN SECONDS TOPIC TYPE RELIABLE TRANSIENT_LOCAL [TOPIC TYPE ...]

#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;
using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;

using Bytes = std::vector<char>;

// A type of which only the name is registered, as rmw_fastrtps does; messages stay encoded.
class EncodedType : public TopicDataType {
public:
    explicit EncodedType(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 65536;
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }
    bool serialize(void*, SerializedPayload_t*) override { return false; }
    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void*) override { return [] { return 0u; }; }
    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

struct Decoder {
    FastBuffer buffer;
    Cdr cdr;
    explicit Decoder(Bytes& bytes)
        : buffer(bytes.data(), bytes.size()), cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR) {
        cdr.read_encapsulation();
    }
    template <class T> T take() {
        T value{};
        cdr >> value;
        return value;
    }
    std::vector<double> take_doubles(size_t count) {
        std::vector<double> values(count);
        for (double& value : values) cdr >> value;
        return values;
    }
    double take_stamp() {
        const int32_t seconds = take<int32_t>();
        return seconds + 1e-9 * take<uint32_t>();
    }
};

static std::string join(const std::vector<double>& values) {
    std::string text = "[";
    char number[40];
    for (size_t n = 0; n < values.size(); ++n) {
        std::snprintf(number, sizeof number, "%s%.17g", n ? "," : "", values[n]);
        text += std::isfinite(values[n]) ? number : (n ? ",null" : "null");
    }
    return text + "]";
}

// The decoded message as members of a JSON object.
static std::string describe(const std::string& type, Bytes& bytes) {
    Decoder in(bytes);
    if (type == "tf2_msgs::msg::dds_::TFMessage_") {
        std::string text = "\"transforms\":[";
        const uint32_t count = in.take<uint32_t>();
        for (uint32_t n = 0; n < count; ++n) {
            in.take_stamp();
            const auto frame = in.take<std::string>(), child = in.take<std::string>();
            text += (n ? "," : "") + std::string("{\"frame\":\"") + frame + "\",\"child\":\"" + child +
                    "\",\"values\":" + join(in.take_doubles(7)) + "}";
        }
        return text + "]";
    }
    char stamp[60];
    std::snprintf(stamp, sizeof stamp, "\"stamp\":%.9f", in.take_stamp());
    std::string text = std::string(stamp) + ",\"frame\":\"" + in.take<std::string>() + "\"";
    if (type == "nav_msgs::msg::dds_::Odometry_") {
        text += ",\"child\":\"" + in.take<std::string>() + "\"";
        text += ",\"values\":" + join(in.take_doubles(7 + 36 + 6 + 36));
    } else if (type == "sensor_msgs::msg::dds_::Imu_") {
        text += ",\"values\":" + join(in.take_doubles(4 + 9 + 3 + 9 + 3 + 9));
    } else if (type == "sensor_msgs::msg::dds_::Temperature_") {
        text += ",\"values\":" + join(in.take_doubles(2));
    } else if (type == "sensor_msgs::msg::dds_::BatteryState_") {
        std::vector<double> values;
        for (int n = 0; n < 7; ++n) values.push_back(in.take<float>());
        text += ",\"values\":" + join(values);
    } else if (type == "diagnostic_msgs::msg::dds_::DiagnosticArray_") {
        const uint32_t count = in.take<uint32_t>();
        text += ",\"status\":[";
        for (uint32_t n = 0; n < count; ++n) {
            const int level = in.take<uint8_t>();
            text += (n ? "," : "") + std::string("[") + std::to_string(level) + ",\"" + in.take<std::string>() + "\"]";
            in.take<std::string>();
            in.take<std::string>();
            for (uint32_t pairs = in.take<uint32_t>(); pairs; --pairs) {
                in.take<std::string>();
                in.take<std::string>();
            }
        }
        text += "]";
    }
    return text;
}

class Counter : public DataReaderListener {
public:
    std::string topic, type;
    std::mutex lock;
    long count = 0;
    int matched = 0, incompatible = 0, errors = 0;
    std::string last;
    std::vector<double> arrivals;  // of odometry: stamp and time of arrival, s, in turn
    double first = 0, latest = 0;

    void on_subscription_matched(DataReader*, const SubscriptionMatchedStatus& status) override {
        if (status.current_count_change > 0) ++matched;
    }
    void on_requested_incompatible_qos(DataReader*, const RequestedIncompatibleQosStatus&) override { ++incompatible; }
    void on_data_available(DataReader* reader) override {
        Bytes bytes;
        SampleInfo info;
        while (reader->take_next_sample(&bytes, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            const double now = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
            std::lock_guard<std::mutex> guard(lock);
            first = count ? first : now;
            latest = now;
            if (type == "nav_msgs::msg::dds_::Odometry_") {
                Decoder stamp(bytes);
                arrivals.push_back(stamp.take_stamp());
                arrivals.push_back(now);
            }
            ++count;
            try {
                last = describe(type, bytes);
            } catch (const std::exception&) {
                ++errors;
            }
        }
    }
};

int main(int argc, char** argv) {
    if (argc < 7) return 2;
    DomainParticipantQos participant_qos;
    participant_qos.name("interop");
    DomainParticipant* participant =
        DomainParticipantFactory::get_instance()->create_participant(std::atoi(argv[1]), participant_qos);
    Subscriber* subscriber = participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::vector<std::unique_ptr<Counter>> counters;
    for (int n = 3; n + 3 < argc; n += 4) {
        auto counter = std::make_unique<Counter>();
        counter->topic = argv[n];
        counter->type = argv[n + 1];
        TypeSupport type(new EncodedType(counter->type));
        type.register_type(participant);
        Topic* topic = participant->create_topic(counter->topic, counter->type, TOPIC_QOS_DEFAULT);
        DataReaderQos qos = DATAREADER_QOS_DEFAULT;
        qos.reliability().kind = std::atoi(argv[n + 2]) ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        qos.durability().kind = std::atoi(argv[n + 3]) ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        qos.history().kind = KEEP_LAST_HISTORY_QOS;
        qos.history().depth = 50;
        subscriber->create_datareader(topic, qos, counter.get());
        counters.push_back(std::move(counter));
    }
    std::printf("ready\n");
    std::fflush(stdout);
    std::this_thread::sleep_for(std::chrono::duration<double>(std::atof(argv[2])));
    for (auto& counter : counters) {
        std::lock_guard<std::mutex> guard(counter->lock);
        const double span = counter->latest - counter->first;
        std::printf("{\"topic\":\"%s\",\"count\":%ld,\"matched\":%d,\"incompatible\":%d,\"errors\":%d,\"rate\":%.2f,\"arrivals\":%s%s%s}\n",
                    counter->topic.c_str(), counter->count, counter->matched, counter->incompatible, counter->errors,
                    span > 0 ? (counter->count - 1) / span : 0.0, join(counter->arrivals).c_str(), counter->last.empty() ? "" : ",",
                    counter->last.c_str());
    }
    std::fflush(stdout);
    std::_Exit(0);
}
