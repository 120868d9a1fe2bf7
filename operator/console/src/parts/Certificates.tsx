import type { Certificate } from "../live/model";
import { Badge } from "./parts";
import { certificateState, renewalWords } from "./states";

/** Until when the certificates hold by which an agent's accounts are proved at the broker. */
export function Certificates({ certificates, now }: { certificates: readonly Certificate[]; now: number }) {
  if (!certificates.length) return <span class="quiet">none is known</span>;
  return (
    <>
      {certificates.map((certificate) => {
        const { tone, words } = certificateState(certificate, now);
        return (
          <div key={certificate.account}>
            {certificates.length > 1 && <>{certificate.account} </>}
            <Badge tone={tone}>{words}</Badge>
            <div class="quiet">{renewalWords(certificate, now)}</div>
          </div>
        );
      })}
    </>
  );
}
