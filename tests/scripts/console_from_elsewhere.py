"""What another host gets of a console: run in a network namespace of its own, as

    unshare --user --map-root-user --net --fork --kill-child python3 console_from_elsewhere.py TROCAR FOLDER

It makes a second namespace, which is the other host, with a cable between the two, starts consoles here, and asks from there."""

import http.client
import json
import os
import pathlib
import socket
import ssl
import subprocess
import sys
import threading

HERE, THERE = "10.77.0.1", "10.77.0.2"


def sh(*words):
    subprocess.run(words, check=True)


def cable():
    """A second namespace, held by the process that is given, and a cable to it."""
    holder = subprocess.Popen(["unshare", "--net", "sh", "-c", "echo; exec sleep 600"], stdout=subprocess.PIPE)
    holder.stdout.readline()
    inside = ["nsenter", "--target", str(holder.pid), "--net"]
    sh("ip", "link", "set", "lo", "up")
    sh("ip", "link", "add", "here", "type", "veth", "peer", "name", "there", "netns", str(holder.pid))
    sh("ip", "address", "add", f"{HERE}/24", "dev", "here")
    sh("ip", "link", "set", "here", "up")
    sh(*inside, "ip", "address", "add", f"{THERE}/24", "dev", "there")
    sh(*inside, "ip", "link", "set", "there", "up")
    return holder, inside


def console(trocar, folder, address):
    """A run with a console at `address`, and its URL."""
    environment = os.environ | {"XDG_STATE_HOME": folder, "XDG_RUNTIME_DIR": folder}
    words = [trocar, "run", "--task", "needle-lift", "--policy", "noop", "--set", "scene.episode.time_limit_s=300"]
    run = subprocess.Popen([*words, "--console", address], env=environment, stderr=subprocess.PIPE, text=True)
    for line in run.stderr:
        if "console: " in line:
            threading.Thread(target=run.stderr.read, daemon=True).start()
            return run, line.split("console: ")[1].strip()
    sys.exit("no console")


def main(trocar, folder):
    holder, inside = cable()
    runs = []
    try:
        loopback, closed = console(trocar, folder, "127.0.0.1:0")
        runs.append(loopback)
        beyond, url = console(trocar, folder, "0.0.0.0:0")
        runs.append(beyond)
        assert url.startswith(f"https://{HERE}:"), url
        certificate = pathlib.Path(folder, "certificate.pem")
        kept = json.loads(pathlib.Path(folder, "trocar/console.json").read_text())
        certificate.write_text(kept["certificate"])
        port = closed.split("/?")[0].rsplit(":", 1)[1]
        sh(*inside, sys.executable, "-B", __file__, "--there", url, str(certificate), port)
    finally:
        for process in [*runs, holder]:
            process.kill()


def there(url, certificate, loopback_port):
    """Asks from the other host."""
    address, token = url.removeprefix("https://").split("/?token=")
    host, port = address.split(":")
    trust = ssl.create_default_context(cafile=certificate)
    upgrade = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}

    def ask(path, headers):
        connection = http.client.HTTPSConnection(host, int(port), context=trust, timeout=60)
        connection.request("GET", path, headers=headers)
        answer = connection.getresponse()
        status, text = answer.status, b"" if answer.status == 101 else answer.read()
        connection.close()
        assert status in (200, 101) or token.encode() not in text
        return status

    cookie = {"Cookie": f"trocar_console_{port}={token}"}
    wrong = {"Cookie": f"trocar_console_{port}={'0' * len(token)}"}
    own, foreign = {"Origin": f"https://{address}"}, {"Origin": "https://evil.example"}
    refusals = [
        ("/", {}, 401), ("/main.js", {}, 401), ("/scene.glb", {}, 401), ("/socket", {}, 401), ("/?token=0", {}, 401), ("/", wrong, 401),
        ("/socket", upgrade, 403), ("/socket", upgrade | own, 401), ("/socket", upgrade | own | wrong, 401),
        ("/socket", upgrade | foreign | cookie, 403), ("/?token=" + token, {"Host": "evil.example"}, 421),
        ("/socket", upgrade | own | cookie | {"Host": "localhost.evil.example"}, 421),
    ]
    for path, headers, status in refusals:
        got = ask(path, headers)
        assert got == status or (path == "/socket" and not headers and got >= 400), (path, headers, got)
    served = [("/?token=" + token, {}, 200), ("/main.js", cookie, 200), ("/socket", upgrade | own | cookie, 101)]
    for path, headers, status in served:
        got = ask(path, headers)
        assert got == status, (path, headers, got)
    # Plain HTTP, with the token.
    plain = http.client.HTTPConnection(host, int(port), timeout=60)
    plain.request("GET", "/?token=" + token)
    answer = plain.getresponse()
    assert answer.status == 400 and b"TLS alone" in answer.read()
    # What listens at loopback is not there at all.
    try:
        socket.create_connection((host, int(loopback_port)), timeout=60)
        sys.exit("a console at loopback is reached from another host")
    except ConnectionRefusedError:
        pass
    print(f"refused: {len(refusals) + 2}, served: {len(served)}", flush=True)


if __name__ == "__main__":
    there(*sys.argv[2:]) if sys.argv[1] == "--there" else main(*sys.argv[1:])
